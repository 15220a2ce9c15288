//! The command line of the example `render`: its output, its exit codes, and the files that it writes.
//!
//! `cargo test` and `cargo nextest run` build the example; `cargo test --test frames` alone takes it as it was last
//! built.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use base64::Engine as _;
use serde_json::{Value, json};
use tempfile::TempDir;

/// The output of one run, and the files that it has added to the folder.
struct Run {
    code: Option<i32>,
    stdout: String,
    stderr: String,
    files: Vec<String>,
}

/// Runs the example in `folder`.
fn render(folder: &TempDir, arguments: &[&str]) -> Run {
    let before = names_in(folder.path());
    let output = Command::new(executable()).args(arguments).current_dir(folder).output().unwrap();
    let mut files = names_in(folder.path());
    files.retain(|file| !before.contains(file));
    Run {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
        files,
    }
}

/// Runs the example on the CPU for a small image, in a folder with the file "two.gltf", and expects success.
#[track_caller]
fn render_small(folder: &TempDir, arguments: &[&str]) -> Run {
    let run = render(folder, &[&["--device", "cpu", "--size", "40x30", "--samples", "1"], arguments].concat());
    assert_eq!(run.code, Some(0), "{arguments:?}: {}", run.stderr);
    // Only notes about the file.
    assert!(run.stderr.lines().all(|line| line.starts_with("note: ")), "{arguments:?}: {}", run.stderr);
    run
}

/// Ctrl+C after the first of many images: the program ends by itself, and every image that is there is whole.
#[cfg(unix)]
#[test]
fn ctrl_c_ends_with_130_and_leaves_whole_images_only() {
    use std::process::Stdio;

    let folder = folder();
    let arguments = ["two.gltf", "--device", "cpu", "--size", "400x300", "--frames", "99999", "--output", "turn.png"];
    let mut command = Command::new(executable());
    let child = command.args(arguments).current_dir(&folder).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = child.spawn().unwrap();
    let images = || names_in(folder.path()).into_iter().filter(|name| name.ends_with(".png")).collect::<Vec<_>>();
    while images().is_empty() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before its first image");
        std::thread::yield_now();
    }
    // The signal is sent by a program, as the standard library sends none.
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(130), &b""[..]));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(stderr.ends_with("\ninterrupted\n"), "{stderr}");
    for name in images() {
        let bytes = fs::read(folder.path().join(&name)).unwrap();
        let decoded = ::image::load_from_memory(&bytes).unwrap();
        assert_eq!((decoded.width(), decoded.height()), (400, 300), "{name}");
    }
    let others: Vec<String> = names_in(folder.path()).into_iter().filter(|name| !name.ends_with(".png")).collect();
    assert_eq!(others, ["two.gltf"], "no file of another name");
}

/// Cargo puts examples beside the folder of the test programs.
fn executable() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let path = test
        .parent()
        .unwrap()
        .parent()
        .unwrap()
        .join("examples/render")
        .with_extension(std::env::consts::EXE_EXTENSION);
    assert!(path.is_file(), "{} is missing: cargo build --example render", path.display());
    path
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A folder with "two.gltf": a scene "red" with cameras "left" and "right" at a triangle, and an empty scene "nothing".
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("two.gltf"), two_scenes().to_string()).unwrap();
    folder
}

fn two_scenes() -> Value {
    let positions: [f32; 9] = [-1.0, -1.0, 0.0, 1.0, -1.0, 0.0, 0.0, 1.0, 0.0];
    let bytes: Vec<u8> = positions.iter().flat_map(|p| p.to_le_bytes()).collect();
    let uri =
        format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(&bytes));
    json!({
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"name": "red", "nodes": [0, 1, 2]}, {"name": "nothing"}],
        "nodes": [
            {"mesh": 0},
            {"camera": 0, "translation": [-0.5, 0.0, 4.0]},
            {"camera": 1, "translation": [0.5, 0.0, 4.0]},
        ],
        "cameras": [
            {"name": "left", "type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}},
            {"name": "right", "type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.0, 0.0, 1.0]}}],
        "accessors": [{
            "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
            "min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, 0.0],
        }],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": uri}],
    })
}

fn pixels(folder: &TempDir, name: &str) -> image::RgbaImage {
    image::open(folder.path().join(name)).unwrap().to_rgba8()
}

#[test]
fn without_arguments_a_picture_of_the_built_in_scene_is_written() {
    // All defaults but the size: an image of the default size takes too long in a test.
    let folder = tempfile::tempdir().unwrap();
    let run = render(&folder, &["--size", "48x30"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert_eq!(run.stdout, "wrote out.png\n");
    assert_eq!(run.files, ["out.png"]);
    // Without a GPU, the error is one line that says so.
    let told = run.stderr.lines().collect::<Vec<_>>();
    assert!(told.len() <= 1 && told.iter().all(|line| line.starts_with("rendering on the CPU: ")), "{}", run.stderr);

    let picture = pixels(&folder, "out.png");
    assert_eq!((picture.width(), picture.height()), (48, 30));
    let colors: std::collections::HashSet<_> = picture.pixels().collect();
    assert!(colors.len() > 500, "only {} colours", colors.len());
}

#[test]
fn a_file_is_rendered_to_png_and_exr() {
    let folder = folder();
    assert_eq!(render_small(&folder, &["two.gltf", "-o", "a b.png"]).files, ["a b.png"]);
    assert_eq!(render_small(&folder, &["two.gltf", "--output", "a.exr"]).files, ["a.exr"]);

    let png = pixels(&folder, "a b.png");
    let [r, g, b, a] = png.get_pixel(20, 15).0;
    assert!(r > 100 && g < 30 && b < 30 && a == 255, "the triangle is {r} {g} {b} {a}");
    let exr = exr::prelude::read_first_flat_layer_from_file(folder.path().join("a.exr")).unwrap();
    assert_eq!((exr.layer_data.size.width(), exr.layer_data.size.height()), (40, 30));
    let names: Vec<_> = exr.layer_data.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["A", "B", "G", "N.X", "N.Y", "N.Z", "R", "Z", "id.node", "id.node_version", "id.triangle"]);
}

#[test]
fn emulated_and_cpu_make_the_same_picture() {
    let folder = folder();
    render_small(&folder, &["--size", "24x15", "-o", "cpu.png"]);
    let run = render(&folder, &["--device", "emulated", "--size", "24x15", "--samples", "1", "-o", "emulated.png"]);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    assert!(pixels(&folder, "cpu.png") == pixels(&folder, "emulated.png"));
}

#[test]
fn a_gpu_renders_or_its_absence_is_explained() {
    let folder = folder();
    let run = render(&folder, &["two.gltf", "--device", "gpu", "--size", "40x30"]);
    match run.code {
        Some(0) => assert_eq!(run.files, ["out.png"]),
        code => {
            assert_eq!(code, Some(2));
            assert!(
                run.stderr.starts_with("error: no usable GPU: ") && run.stderr.lines().count() == 1,
                "{}",
                run.stderr
            );
            assert_eq!(run.files, [""; 0]);
        }
    }
}

#[test]
fn samples_smooth_edges() {
    let folder = folder();
    let count =
        |name: &str| pixels(&folder, name).pixels().map(|p| p.0).collect::<std::collections::HashSet<_>>().len();
    render_small(&folder, &["two.gltf", "-o", "1.png"]);
    render(&folder, &["two.gltf", "--device", "cpu", "--size", "40x30", "--samples", "4", "-o", "4.png"]);
    assert!(count("4.png") > count("1.png") + 10, "{} and {}", count("4.png"), count("1.png"));
}

#[test]
fn depth_says_how_often_a_ray_is_reflected() {
    let folder = folder();
    render_small(&folder, &["--depth", "0", "-o", "0.png"]);
    render_small(&folder, &["-o", "default.png"]);
    render_small(&folder, &["--depth", "3", "-o", "3.png"]);
    let [none, default, three] = ["0.png", "default.png", "3.png"].map(|name| pixels(&folder, name));
    assert!(none != three && default == three);
}

#[test]
fn cameras_are_chosen_by_name_and_number() {
    let folder = folder();
    for (i, camera) in [None, Some("0"), Some("left"), Some("1"), Some("right")].into_iter().enumerate() {
        let output = format!("{i}.png");
        let chosen: Vec<&str> = camera.into_iter().flat_map(|camera| ["--camera", camera]).collect();
        render_small(&folder, &[&["two.gltf", "-o", &output], chosen.as_slice()].concat());
    }
    let [default, zero, left, one, right] = [0, 1, 2, 3, 4].map(|i| pixels(&folder, &format!("{i}.png")));
    assert!(default == zero && zero == left && one == right && left != right);
}

#[test]
fn scenes_are_chosen_by_name_and_number() {
    let folder = folder();
    for (i, scene) in ["0", "red", "1", "nothing"].into_iter().enumerate() {
        render_small(&folder, &["two.gltf", "-o", &format!("{i}.png"), "--scene", scene]);
    }
    let [zero, red, one, nothing] = [0, 1, 2, 3].map(|i| pixels(&folder, &format!("{i}.png")));
    assert!(zero == red && one == nothing && red != one);
}

#[test]
fn files_outside_of_the_folder_are_read_where_that_is_allowed() {
    let folder = folder();
    let mut file = two_scenes();
    let (_, data) = file["buffers"][0]["uri"].as_str().unwrap().split_once(',').unwrap();
    let bytes = base64::engine::general_purpose::STANDARD.decode(data).unwrap();
    for name in ["own", "shared", "empty"] {
        fs::create_dir(folder.path().join(name)).unwrap();
    }
    fs::write(folder.path().join("shared/triangle.bin"), bytes).unwrap();
    file["buffers"][0]["uri"] = json!("../shared/triangle.bin");
    fs::write(folder.path().join("own/scene.gltf"), file.to_string()).unwrap();

    assert_refused(&folder, &["own/scene.gltf"], &["own/scene.gltf", "/buffers/0", "../shared/triangle.bin"]);
    assert_refused(&folder, &["own/scene.gltf", "--allow-folder", "empty"], &["/buffers/0"]);
    assert_refused(&folder, &["own/scene.gltf", "--allow-folder", "nowhere"], &["--allow-folder", "nowhere"]);
    let allowed = ["own/scene.gltf", "--allow-folder", "shared", "--allow-folder", "empty", "-o", "a.png"];
    assert_eq!(render_small(&folder, &allowed).files, ["a.png"]);
}

#[test]
fn what_an_import_may_take_can_be_limited() {
    let folder = folder();
    let nodes: Vec<Value> = (0..20_000).map(|i| json!({ "name": format!("node {i}") })).collect();
    fs::write(folder.path().join("many.gltf"), json!({ "asset": { "version": "2.0" }, "nodes": nodes }).to_string())
        .unwrap();
    assert_refused(&folder, &["many.gltf", "--memory", "1"], &["many.gltf", "1 MiB"]);
    assert_eq!(render_small(&folder, &["many.gltf", "--memory", "500"]).files, ["out.png"]);
}

#[test]
fn thousands_of_notes_take_a_few_lines() {
    let folder = folder();
    let broken = json!({ "type": "perspective", "perspective": { "yfov": -1.0, "znear": 0.1 } });
    let nodes: Vec<Value> = (0..1500).map(|camera| json!({ "camera": camera })).collect();
    let file = json!({ "asset": { "version": "2.0" }, "cameras": vec![broken; 1500], "nodes": nodes });
    fs::write(folder.path().join("cameras.gltf"), file.to_string()).unwrap();
    let run = render_small(&folder, &["cameras.gltf"]);
    let notes: Vec<&str> = run.stderr.lines().filter(|line| line.starts_with("note: ")).collect();
    assert!(notes.len() <= 22, "{notes:?}");
    assert!(notes.last().unwrap().contains("... and 1490 more"), "{notes:?}");
}

#[test]
fn json_is_all_there_is_on_standard_output() {
    let folder = folder();
    let run = render_small(&folder, &["two.gltf", "--json"]);
    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!(report["file"], "two.gltf");
    assert_eq!(report["size"], json!([40, 30]));
    let frame = &report["frames"][0];
    assert_eq!(frame["output"], "out.png");
    assert_eq!(frame["device"]["executor"], "cpu");
    assert_eq!((&frame["compile"]["unique_triangles"], &frame["compile"]["instances"]), (&json!(1), &json!(1)));
    assert!(frame["trace_time"].as_f64().unwrap() > 0.0);
    assert_eq!(run.files, ["out.png"]);
}

#[test]
fn stats_are_tables() {
    let run = render_small(&folder(), &["two.gltf", "--stats"]);
    for expected in ["two.gltf", "40x30, 1200 primary rays", "built", "trace", "wrote out.png"] {
        assert!(run.stdout.contains(expected), "no {expected:?} in\n{}", run.stdout);
    }
}

#[test]
fn notes_about_the_file_are_a_line_each_and_many_of_a_kind_are_folded() {
    let folder = folder();
    let run = render_small(&folder, &["two.gltf"]);
    let note = |i: usize, name: &str| {
        format!(
            "note: two.gltf: /cameras/{i} \"{name}\": clip planes: znear and zfar are not used: all that is in front of the \
             camera is seen"
        )
    };
    assert_eq!(run.stderr.lines().collect::<Vec<_>>(), [note(0, "left"), note(1, "right")]);
    // As JSON, they are in the report.
    let run = render_small(&folder, &["two.gltf", "--json"]);
    assert_eq!(run.stderr, "");
    assert_eq!(serde_json::from_str::<Value>(&run.stdout).unwrap()["warnings"].as_array().unwrap().len(), 2);

    // Ten of a kind are told, the others counted; other kinds are told all the same. No control character is printed.
    let mut many = two_scenes();
    many["cameras"] = json!([]);
    many["nodes"] = json!([{"mesh": 0}]);
    many["scenes"] = json!([{"nodes": [0]}]);
    many["animations"] = (0..47).map(|_| json!({"name": "\u{1b}[31mred\n"})).collect();
    many["materials"][0]["occlusionTexture"] = json!({"index": 0});
    many["textures"] = json!([{}]);
    fs::write(folder.path().join("many.gltf"), many.to_string()).unwrap();
    let run = render_small(&folder, &["many.gltf", "--stats"]);
    let lines: Vec<_> = run.stderr.lines().collect();
    assert_eq!(lines.len(), 12, "{lines:?}");
    assert!(lines[9].starts_with("note: many.gltf: /animations/9 \"\\u{1b}[31mred\\n\": animation: "), "{lines:?}");
    assert_eq!(lines[10], "note: many.gltf: ... and 37 more of this kind");
    assert!(lines[11].contains("occlusion texture"), "{lines:?}");
    assert!(!(run.stderr.clone() + &run.stdout).contains('\u{1b}'));
}

#[test]
fn a_camera_that_was_left_out_is_named_where_it_is_missed() {
    let folder = folder();
    let mut file = two_scenes();
    file["nodes"][1]["scale"] = json!([0, 0, 0]);
    file["nodes"][1]["name"] = json!("eye");
    fs::write(folder.path().join("scale0.gltf"), file.to_string()).unwrap();
    // The first camera that there is shows the rest.
    let run = render_small(&folder, &["scale0.gltf"]);
    assert!(
        run.stderr
            .contains("note: scale0.gltf: /nodes/1 \"eye\": camera 0: is scaled to zero along an axis: left out\n"),
        "{}",
        run.stderr
    );
    assert_refused(
        &folder,
        &["scale0.gltf", "--camera", "left"],
        &["\"left\"", "\"right\"", "scale0.gltf: /nodes/1 \"eye\": camera 0"],
    );
}

#[test]
fn a_turntable_is_numbered_and_builds_nothing_after_its_first_frame() {
    let folder = folder();
    let run = render_small(&folder, &["two.gltf", "--frames", "10", "-o", "turn.png", "--json"]);
    let expected: Vec<_> = (1..=10).map(|i| format!("turn-{i:02}.png")).collect();
    assert_eq!(run.files, expected);
    assert!(pixels(&folder, "turn-01.png") != pixels(&folder, "turn-03.png"));

    let report: Value = serde_json::from_str(&run.stdout).unwrap();
    let frames = report["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 10);
    for frame in &frames[1..] {
        assert_eq!(frame["compile"]["tlas"], "kept");
        assert_eq!(frame["compile"]["blas_built"], 0);
    }
}

#[test]
fn help_and_version_are_answers() {
    let folder = folder();
    for (argument, expected) in [("--help", "--camera <NAME|INDEX>"), ("--version", "render ")] {
        let run = render(&folder, &[argument]);
        assert_eq!((run.code, run.stderr.as_str()), (Some(0), ""));
        assert!(run.stdout.contains(expected), "{}", run.stdout);
        assert_eq!(run.files, [""; 0]);
    }
}

/// Expects exit code 2, one line that contains each of `named`, nothing on standard output, and no new file.
#[track_caller]
fn assert_refused(folder: &TempDir, arguments: &[&str], named: &[&str]) {
    let run = render(folder, arguments);
    assert_eq!(run.code, Some(2), "{arguments:?}: {}", run.stderr);
    assert!(run.stderr.starts_with("error: ") && run.stderr.lines().count() == 1, "{arguments:?}: {}", run.stderr);
    for name in named {
        assert!(run.stderr.contains(name), "{arguments:?}: no {name:?} in {}", run.stderr);
    }
    assert_eq!(run.stdout, "", "{arguments:?}");
    assert_eq!(run.files, [""; 0], "{arguments:?}");
}

#[test]
fn bad_arguments_are_refused_in_one_line() {
    let folder = folder();
    fs::create_dir(folder.path().join("folder.png")).unwrap();
    for (arguments, named) in [
        (&["--size", "12"][..], &["--size", "12", "960x600"][..]),
        (&["--size", "0x10"], &["--size", "0x10", "from 1"]),
        (&["--size", "-5x10"], &["-5"]),
        (&["--size", "99999999999x1"], &["--size", "16384"]),
        (&["--size", "16384x16384", "--samples", "16"], &["--size", "--samples", "134217728"]),
        (&["--samples", "0"], &["--samples"]),
        (&["--device", "abacus"], &["--device", "abacus", "emulated"]),
        (&["--depth", "many"], &["--depth", "many"]),
        (&["--min-throughput", "2"], &["--min-throughput", "2", "0 to 1"]),
        (&["--near", "inf"], &["--near", "inf", "finite"]),
        (&["--depth", "-1"], &["-1"]),
        (&["--frames", "0"], &["--frames", "0"]),
        (&["--frames", "many"], &["--frames", "many"]),
        (&["-o", "out.jpg"], &["out.jpg", ".png", ".exr"]),
        (&["-o", "no/such/folder/out.png"], &["no/such/folder"]),
        (&["--device", "cpu", "--size", "8x8", "-o", "folder.png"], &["folder.png"]),
        (&["--camera", "middle"], &["middle", "camera"]),
        (&["--camera", "1"], &["\"1\"", "camera"]),
        (&["two.gltf", "--camera", "middle"], &["middle", "\"left\"", "\"right\""]),
        (&["two.gltf", "--camera", "2"], &["\"2\"", "\"left\""]),
        (&["two.gltf", "--scene", "nothing", "--camera", "0"], &["\"0\"", "none"]),
        (&["two.gltf", "--scene", "2"], &["two.gltf", "2"]),
        (&["two.gltf", "--scene", "blue"], &["two.gltf", "blue"]),
        (&["--scene", "red"], &["--scene", "no file"]),
        (&["two.gltf", "three.gltf"], &["three.gltf"]),
        (&["--spp"], &["--spp"]),
    ] {
        assert_refused(&folder, arguments, named);
    }
}

#[test]
fn bad_files_are_refused_in_one_line_that_names_file_object_and_cause() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| fs::write(folder.path().join(name), content).unwrap();
    write("empty.glb", b"");
    write("text.gltf", b"Dear reader,\nthis is not JSON");
    write("picture.glb", b"\x89PNG\r\n\x1a\n0123456789abcdef");
    write("cut.gltf", &two_scenes().to_string().as_bytes()[..300]);
    fs::create_dir(folder.path().join("folder.gltf")).unwrap();
    let edited = |name: &str, pointer: &str, value: Value| {
        let mut document = two_scenes();
        *document.pointer_mut(pointer).unwrap() = value;
        write(name, document.to_string().as_bytes());
    };
    edited("cycle.gltf", "/nodes/0", json!({"children": [0]}));
    edited("range.gltf", "/nodes/0/mesh", json!(7));
    edited("short.gltf", "/accessors/0/count", json!(4000));
    let mut draco = two_scenes();
    draco["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    draco["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    write("draco.gltf", draco.to_string().as_bytes());

    for (file, named) in [
        ("missing.glb", &["missing.glb"][..]),
        ("empty.glb", &["empty.glb"]),
        ("text.gltf", &["text.gltf"]),
        ("picture.glb", &["picture.glb"]),
        ("cut.gltf", &["cut.gltf"]),
        ("folder.gltf", &["folder.gltf"]),
        ("cycle.gltf", &["cycle.gltf", "/nodes/0"]),
        ("range.gltf", &["range.gltf", "/nodes/0/mesh", "7"]),
        ("short.gltf", &["short.gltf", "/accessors/0"]),
        ("draco.gltf", &["draco.gltf", "KHR_draco_mesh_compression"]),
    ] {
        assert_refused(&folder, &[file], named);
    }
}

#[test]
fn an_older_picture_survives_a_failed_run() {
    let folder = folder();
    fs::write(folder.path().join("out.png"), "old").unwrap();
    assert_refused(&folder, &["missing.glb"], &["missing.glb"]);
    assert_eq!(fs::read(folder.path().join("out.png")).unwrap(), b"old");
}
