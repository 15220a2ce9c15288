//! Mutation of inputs, which knows nothing of their format but some words of glTF.

use fastrand::Rng;

/// The longest input.
const MAX_LENGTH: usize = 1 << 16;

/// Numbers at which something ends.
const NUMBERS: &[&str] = &[
    "0",
    "1",
    "-1",
    "2",
    "3",
    "4",
    "5",
    "7",
    "0.5",
    "1e30",
    "-1e300",
    "1e-320",
    "255",
    "256",
    "5120",
    "5121",
    "5123",
    "5125",
    "5126",
    "65535",
    "65536",
    "4294967295",
    "4294967296",
    "9007199254740993",
    "18446744073709551615",
    "1.0",
];

/// Values and members that glTF files have.
const WORDS: &[&str] = &[
    "null",
    "true",
    "false",
    "\"\"",
    "[]",
    "{}",
    "[0]",
    "[0,0,0]",
    "[1,2,3,4]",
    "\"MASK\"",
    "\"BLEND\"",
    "\"SCALAR\"",
    "\"VEC2\"",
    "\"VEC3\"",
    "\"VEC4\"",
    "\"MAT4\"",
    "\"data:;base64,AAAA\"",
    "\"data:,x\"",
    "\"../x\"",
    "\"%00\"",
    ",\"name\":\"n\"",
    ",\"extras\":[[{}]]",
    ",\"byteOffset\":4",
    ",\"byteStride\":8",
    ",\"bufferView\":0",
    ",\"mode\":5",
    ",\"mode\":6",
    ",\"indices\":1",
    ",\"material\":0",
    ",\"skin\":0",
    ",\"mesh\":0",
    ",\"camera\":0",
    ",\"children\":[1]",
    ",\"weights\":[1]",
    ",\"normalized\":true",
    ",\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]",
    ",\"scale\":[0,0,0]",
    ",\"rotation\":[0,0,0,2]",
    ",\"translation\":[1e38,0,0]",
    ",\"extensions\":{}",
    ",\"KHR_materials_unlit\":{}",
    ",\"KHR_node_visibility\":{\"visible\":false}",
    ",\"NORMAL\":0",
    ",\"TEXCOORD_1\":2",
    ",\"COLOR_0\":0",
    ",\"JOINTS_0\":3",
    ",\"WEIGHTS_0\":4",
    ",\"TANGENT\":0",
    ",\"alphaCutoff\":0.5",
    ",\"sparse\":{\"count\":1,\"indices\":{\"bufferView\":0,\"componentType\":5121},\"values\":{\"bufferView\":0}}",
];

/// A mutation of one of the inputs in a pool that is not empty.
pub(crate) fn mutate(pool: &[Vec<u8>], random: &mut Rng) -> Vec<u8> {
    let mut input = pool[random.usize(..pool.len())].clone();
    for _ in 0..1 << random.u32(..4) {
        mutate_once(&mut input, pool, random);
    }
    input.truncate(MAX_LENGTH);
    input
}

fn mutate_once(input: &mut Vec<u8>, pool: &[Vec<u8>], random: &mut Rng) {
    let at = random.usize(..=input.len());
    let most = 1 << random.u32(..8);
    let length = random.usize(..=(input.len() - at).min(most));
    let range = at..at + length;
    match random.u32(..11) {
        // A bit, a byte, a word.
        0 if at < input.len() => input[at] ^= 1 << random.u32(..8),
        1 if at < input.len() => input[at] = random.u8(..),
        2 if at < input.len() => input[at] = *random.choice(&[0, 1, 127, 128, 255]).unwrap_or(&0),
        3 if at + 4 <= input.len() => {
            let word = *random.choice(&[0, 1, u32::MAX, 1 << 31, 0x7f80_0000, 0x7fc0_0000, 0xff7f_ffff]).unwrap_or(&0);
            input[at..at + 4].copy_from_slice(&u32::to_le_bytes(word));
        }
        // A part goes, comes twice, or is replaced by a part of another input.
        4 => drop(input.drain(range)),
        5 => {
            let part = input[range].to_owned();
            input.splice(at..at, part);
        }
        6 => {
            let other = &pool[random.usize(..pool.len())];
            let from = random.usize(..=other.len());
            let part = &other[from..other.len().min(from + length)];
            input.splice(range, part.iter().copied());
        }
        7 => drop(input.splice(at..at, (0..random.usize(..5)).map(|_| random.u8(..)).collect::<Vec<_>>())),
        // A number or a word of text.
        8 | 9 => {
            let Some(number) = number_at_or_after(input, at) else { return };
            let text = random.choice(NUMBERS).unwrap_or(&"0");
            input.splice(number, text.bytes());
        }
        _ => {
            let text = random.choice(WORDS).unwrap_or(&"0");
            // Members go to the end of a value, values replace a number.
            let place = if text.starts_with(',') {
                input.iter().skip(at).position(|&b| b == b'}').map(|i| at + i..at + i)
            } else {
                number_at_or_after(input, at)
            };
            if let Some(place) = place {
                input.splice(place, text.bytes());
            }
        }
    }
}

/// Where the next number of a text is.
fn number_at_or_after(input: &[u8], at: usize) -> Option<std::ops::Range<usize>> {
    let is_part = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-');
    let start = at + input.iter().skip(at).position(u8::is_ascii_digit)?;
    let length = input[start..].iter().position(|b| !is_part(b)).unwrap_or(input.len() - start);
    Some(start..start + length)
}
