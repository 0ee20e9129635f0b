//! What the logger says in one line when it cannot work, without harm to what is there; boards and sensors that it does
//! not know, which lose nothing; and keys, which are nowhere but in the registry.

use std::fs;
use std::io::Read;
use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Stdio;

use link_bench::Bench;
use thermokin::logger::registry::Registry;

mod link_bench;

/// A bench with some virtual boards in its registry.
fn bench(first: &str, count: &str) -> Bench {
    let bench = Bench::new();
    let boards = ["board", "virtual", "--registry", "boards.toml", "--first", first, "--count", count];
    bench.run(&[&boards[..], &["--seed", "1", "--duration", "0", "--drain", "0"]].concat());
    bench
}

/// Starts a logger that cannot work; its one line and its exit code.
fn refused(bench: &Bench, arguments: &[&str]) -> (String, Option<i32>) {
    let output = bench.thermokin(&["log", "--plain"]).args(arguments).output().expect("it runs");
    let words = String::from_utf8(output.stderr).expect("text");
    assert_eq!((output.stdout.len(), words.lines().count()), (0, 1), "{words}");
    (words, output.status.code())
}

#[test]
fn a_port_that_is_taken_and_an_address_of_another_machine() {
    let bench = bench("0", "1");
    let taken = UdpSocket::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let at = |address: &str| refused(&bench, &["--registry", "boards.toml", "--listen", address]);
    assert_eq!(at(&address), (format!("thermokin: {address}: Address already in use (os error 98)\n"), Some(1)));
    // An address for documentation, which no machine has.
    let (words, code) = at("192.0.2.1:4840");
    assert!(words.starts_with("thermokin: 192.0.2.1:4840: Cannot assign") && code == Some(1), "{words}");
    assert!(!bench.path("thermokin-log").exists(), "nothing is begun");
}

#[test]
fn a_store_that_cannot_be_written_or_is_in_use() {
    let bench = bench("0", "1");
    let in_store =
        |store: &str| refused(&bench, &["--registry", "boards.toml", "--listen", "127.0.0.1:0", "--store", store]);
    // The kernel's own folders take no files of anybody, root included.
    let (words, code) = in_store("/sys/kernel/thermokin-log");
    assert!(words.starts_with("thermokin: /sys/kernel/thermokin-log: ") && code == Some(1), "{words}");
    let robot = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/universal-robots-ur10.toml");
    let logger = bench.logger(&["--store", "used", "--robot", robot]);
    let (words, code) = in_store("used");
    assert_eq!((&*words, code), ("thermokin: used: another `thermokin log` is writing to this store\n", Some(1)));
    assert!(logger.stop().contains("universal-robots-ur10.toml puts no sensor on a board"));
}

#[test]
fn a_file_of_another_format_is_left_as_it_is() {
    let bench = bench("0", "1");
    fs::create_dir(bench.path("store")).expect("it is made");
    let foreign = bench.path("store/measurement.mcap");
    for bytes in [&b"time,celsius\n0,20\n"[..], b"\x89PNG\r\n\x1a\n and more", b"SQLite format 3\0"] {
        fs::write(&foreign, bytes).expect("it is written");
        let (words, code) =
            refused(&bench, &["--registry", "boards.toml", "--listen", "127.0.0.1:0", "--store", "store"]);
        assert!(words.contains("store/measurement.mcap: ") && words.contains("MCAP") && code == Some(2), "{words}");
        assert_eq!(fs::read(&foreign).expect("it is there"), bytes);
    }
}

#[test]
fn a_registry_that_is_missing_or_open_to_others() {
    let bench = bench("0", "1");
    let with = |registry: &str| refused(&bench, &["--registry", registry, "--listen", "127.0.0.1:0"]);
    assert_eq!(with("none.toml"), ("thermokin: none.toml: No such file or directory (os error 2)\n".into(), Some(2)));
    fs::set_permissions(bench.path("boards.toml"), fs::Permissions::from_mode(0o640)).expect("it is ours");
    let (words, code) = with("boards.toml");
    assert!(words.contains("boards.toml") && words.contains("600") && code == Some(2), "{words}");
}

#[test]
fn a_board_that_is_not_known_keeps_its_records_until_it_is() {
    let bench = bench("4", "3");
    let all = fs::read_to_string(bench.path("boards.toml")).expect("the registry");
    let (known, _) = all.rsplit_once("[[board]]").expect("three boards");
    let replace = |text: &str| {
        fs::write(bench.path("new.toml"), text).expect("it is written");
        fs::set_permissions(bench.path("new.toml"), fs::Permissions::from_mode(0o600)).expect("it is ours");
        fs::rename(bench.path("new.toml"), bench.path("boards.toml")).expect("it is moved");
    };
    fs::copy(bench.path("boards.toml"), bench.path("all.toml")).expect("it is copied");
    replace(known);
    // A robot with boards 0 to 4.
    let robot = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/comau-nj-130-2.0.toml");
    let logger = bench.logger(&["--robot", robot]);
    let mut boards = bench
        .thermokin(&["board", "virtual", "--registry", "all.toml", "--first", "4", "--count", "3", "--seed", "2"])
        .args([
            "--rate",
            "10",
            "--batch",
            "5",
            "--duration",
            "4",
            "--drain",
            "60",
            "--truth",
            "truth.csv",
            "--host",
            &logger.address,
        ])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the boards start");
    logger.wait_for("board 6 ");
    logger.wait_for("stored as board5/0x48");
    replace(&all);
    assert!(boards.wait().expect("the boards end").success());
    let words = logger.stop();
    let told = |what: &str| words.lines().filter(|line| line.contains(what)).count();
    assert_eq!((told("board 6 at 127.0.0.1 is not in the registry"), told("does not name")), (1, 8), "{words}");
    let truth = bench.json(&["log", "doctor", "thermokin-log", "--truth", "truth.csv"])["truth"].take();
    assert_eq!((&truth["stored"], &truth["wrong"]), (&truth["taken"], &0.into()), "{truth}");
    assert!(truth["taken"].as_u64() >= Some(100), "{truth}");
}

/// Whether a folder has a file with some bytes in it, looked for in all files but those named.
fn contains(folder: &Path, bytes: &[u8], but: &[&str]) -> bool {
    fs::read_dir(folder).expect("it is read").any(|entry| {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            return contains(&path, bytes, but);
        }
        let mut content = Vec::new();
        // A socket cannot be opened.
        let read = fs::File::open(&path).and_then(|mut file| file.read_to_end(&mut content));
        let named = path.file_name().is_some_and(|name| but.iter().any(|but| name == *but));
        read.is_ok() && !named && content.windows(bytes.len()).any(|window| window == bytes)
    })
}

#[test]
fn keys_are_nowhere_but_in_the_registry_and_in_what_a_board_gets() {
    let bench = bench("0", "1");
    let add = ["board", "add", "--registry", "boards.toml", "--board", "7", "--sensors", "0x48"];
    let said = bench.run(&[&add[..], &["--out", "7.toml"]].concat());
    fs::write(bench.path("said.txt"), [said.stdout, said.stderr].concat()).expect("it is written");
    for file in ["boards.toml", "7.toml"] {
        let mode = fs::metadata(bench.path(file)).expect("it is there").permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{file}");
    }
    let registry = Registry::read(&bench.path("boards.toml")).expect("it is a registry");
    let text = fs::read_to_string(bench.path("boards.toml")).expect("it is text");
    let digits: Vec<&str> =
        text.lines().filter_map(|line| line.strip_prefix("key = \"")).map(|line| line.trim_end_matches('"')).collect();
    assert_eq!((digits.len(), digits[0].len()), (registry.boards.len(), 64));

    let logger = bench.logger(&["--json", "log.json"]);
    // Forgers among them, so that refusals are told as well.
    let boards = ["board", "virtual", "--registry", "boards.toml", "--count", "1", "--rate", "20", "--bad-keys", "1"];
    let more = ["--duration", "3", "--drain", "30", "--truth", "truth.csv", "--json", "boards.json"];
    let output = bench.run(&[&boards[..], &more[..], &["--host", &logger.address]].concat());
    fs::write(bench.path("boards.txt"), [output.stdout, output.stderr].concat()).expect("it is written");
    logger.stop();
    fs::write(bench.path("info.txt"), bench.run(&["log", "info", "thermokin-log"]).stdout).expect("it is written");
    fs::write(bench.path("debug.txt"), format!("{registry:?}")).expect("it is written");
    for digits in digits {
        let raw: Vec<u8> = (0..64)
            .step_by(2)
            .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).expect("hexadecimal digits"))
            .collect();
        assert!(contains(bench.path("").as_path(), digits.as_bytes(), &[]), "the search finds what is there");
        for form in [digits.as_bytes(), digits.to_uppercase().as_bytes(), format!("{raw:?}").as_bytes(), &raw] {
            assert!(!contains(bench.path("").as_path(), form, &["boards.toml", "7.toml"]));
        }
    }
}
