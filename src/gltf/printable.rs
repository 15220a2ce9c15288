//! Text from files, made fit to be printed.

use std::fmt::Write as _;

/// The longest message about a file, in characters: a few lines of a terminal.
pub(crate) const MAX_MESSAGE: usize = 480;

/// The text with its control characters escaped, among them line breaks and those that reorder what is written, and cut
/// off after `max_length` characters. A file could otherwise rewrite what a terminal shows, or fill it.
pub(crate) fn printable(text: &str, max_length: usize) -> String {
    let (mut printable, mut length) = (String::new(), 0);
    for character in text.chars() {
        if length >= max_length {
            printable.push_str("...");
            break;
        }
        length += 1;
        if character.is_control() || is_invisible_format(character) {
            let escaped = character.escape_default();
            length += escaped.len() - 1;
            // Writing to a string cannot fail.
            let _ = write!(printable, "{escaped}");
        } else {
            printable.push(character);
        }
    }
    printable
}

/// Line and paragraph separators, and the marks that change the direction of text.
fn is_invisible_format(character: char) -> bool {
    matches!(character, '\u{200E}' | '\u{200F}' | '\u{2028}'..='\u{202E}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_long_text_is_cut() {
        assert_eq!(printable("M\u{f6}bel \"a\"", 80), "M\u{f6}bel \"a\"");
        assert_eq!(printable("\u{1b}[31mred\n\u{202e}\u{9b}0m", 80), "\\u{1b}[31mred\\n\\u{202e}\\u{9b}0m");
        assert_eq!(printable("\n\n\n", 4), "\\n\\n...");
        assert_eq!(printable("\u{2764}\u{2764}\u{2764}", 2), "\u{2764}\u{2764}...");
    }
}
