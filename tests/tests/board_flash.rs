//! `thermokin board config` and `flash`: the page that the firmware's own parser reads, and what espflash is asked for.

mod board_support;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use board_support::{Workshop, thermokin};
use thermokin_protocol::{Configuration, SensorKind};

/// The first digits of board 0's key in the workshop's registry.
const KEY_DIGITS: &str = "000102030405";

fn page_arguments(workshop: &Workshop) -> Vec<String> {
    let password = workshop.file("wifi.txt");
    fs::write(&password, "long enough\nnot this\n").unwrap();
    let registry = workshop.file("boards.toml");
    let given = ["--board=0", "--host=logger.local", "--ssid=cell"].map(String::from);
    let files = [("--password-file", &password), ("--registry", &registry)];
    given.into_iter().chain(files.map(|(option, path)| format!("{option}={}", path.display()))).collect()
}

fn check(page: &Path) {
    let configuration = Configuration::from_page(&fs::read(page).unwrap()).unwrap();
    assert_eq!((configuration.board, configuration.port, configuration.first_boot), (0, 4840, 1));
    assert_eq!(configuration.key.expose()[..3], [0, 1, 2]);
    assert_eq!(configuration.host, "logger.local");
    let sensors: Vec<_> = configuration.sensors.iter().map(|sensor| (sensor.address, sensor.kind)).collect();
    assert_eq!(sensors, [0x48, 0x49, 0x4A, 0x4B].map(|address| (address, SensorKind::Max30205)));
    let wifi = configuration.wifi.unwrap();
    assert_eq!((wifi.ssid.as_str(), wifi.password.as_str()), ("cell", "long enough"));
}

#[test]
fn the_firmwares_parser_reads_what_the_host_writes_and_nobody_else_may() {
    let workshop = Workshop::new("config", 1, 1000, 1, "live");
    let page = workshop.file("board0.page");
    let output = thermokin().args(["board", "config"]).args(page_arguments(&workshop)).arg("--out").arg(&page).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{output:?}");
    check(&page);
    assert_eq!(fs::metadata(&page).unwrap().permissions().mode() & 0o777, 0o600);
    let words = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    assert!(!words.contains(KEY_DIGITS) && !words.contains("long enough"), "{words}");
}

#[test]
fn a_board_that_is_not_in_the_registry_is_one_clear_line() {
    let workshop = Workshop::new("config_unknown", 1, 1000, 1, "live");
    let arguments: Vec<_> =
        page_arguments(&workshop).into_iter().map(|text| text.replace("board=0", "board=7")).collect();
    let output = thermokin().args(["board", "config"]).args(arguments).args(["--out", "/dev/null"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(words.lines().count() == 1 && words.contains("has no board 7"), "{words}");
}

#[test]
fn espflash_is_given_the_configuration_and_then_the_image() {
    let workshop = Workshop::new("flash", 1, 1000, 1, "live");
    let (image, said, kept) = (workshop.file("image"), workshop.file("espflash.txt"), workshop.file("kept.page"));
    fs::write(&image, "an image").unwrap();
    // In espflash's place: notes what it is asked for, and keeps the page.
    let espflash = workshop.file("espflash");
    let script = format!(
        "#!/bin/sh\necho \"$@\" >> {}\nif [ \"$1\" = write-bin ]; then for last; do :; done; cp \"$last\" {}; fi\n",
        said.display(),
        kept.display()
    );
    fs::write(&espflash, script).unwrap();
    fs::set_permissions(&espflash, PermissionsExt::from_mode(0o755)).unwrap();
    let output = thermokin()
        .args(["board", "flash", "--port=/dev/ttyACM0"])
        .args(page_arguments(&workshop))
        .arg("--image")
        .arg(&image)
        .arg("--espflash")
        .arg(&espflash)
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    check(&kept);
    let said = fs::read_to_string(&said).unwrap();
    let lines: Vec<_> = said.lines().collect();
    let [first, second] = lines[..] else { panic!("espflash was called {} times: {said}", lines.len()) };
    assert!(first.starts_with("write-bin --chip esp32c3 --port /dev/ttyACM0 0x3fd000 "), "{first}");
    assert!(second.starts_with("flash --chip esp32c3 --port /dev/ttyACM0 ") && second.ends_with("image"), "{second}");
    let page = first.rsplit(' ').next().unwrap();
    assert!(!Path::new(page).exists(), "the key was left behind in {page}");
    let words = String::from_utf8([output.stdout, output.stderr].concat()).unwrap() + &said;
    assert!(!words.contains(KEY_DIGITS) && !words.contains("long enough"), "{words}");
}

#[test]
fn the_key_for_programs_is_made_once_and_goes_to_every_board() {
    let workshop = Workshop::new("config_update_key", 2, 1000, 1, "live");
    let keys: Vec<_> = (0..2)
        .map(|board| {
            let page = workshop.file(&format!("board{board}.page"));
            let arguments =
                page_arguments(&workshop).into_iter().map(|text| text.replace("board=0", &format!("board={board}")));
            let output =
                thermokin().args(["board", "config"]).args(arguments).arg("--out").arg(&page).output().unwrap();
            assert!(output.status.success(), "{output:?}");
            Configuration::from_page(&fs::read(&page).unwrap()).unwrap().update_key.unwrap()
        })
        .collect();
    assert_eq!(keys[0], keys[1]);
    let secret = workshop.file("update.key");
    assert_eq!(fs::metadata(&secret).unwrap().permissions().mode() & 0o777, 0o600);
    let public: String = keys[0].iter().map(|byte| format!("{byte:02x}")).collect();
    assert!(!fs::read_to_string(secret).unwrap().contains(&public), "boards are given the secret half");
}

#[test]
fn a_program_is_made_an_image_by_espflash_and_handed_to_the_logger_signed() {
    let workshop = Workshop::new("update_handed_over", 1, 1000, 1, "live");
    // An image of an ESP32-C3, as far as it says what it is; espflash is asked for it since the program is an ELF file.
    let mut image = vec![0; 4096];
    image[0] = 0xE9;
    image[12] = 5;
    image[32..36].copy_from_slice(&0xABCD_5432_u32.to_le_bytes());
    image[48..53].copy_from_slice(b"0.3.1");
    let (elf, made, said) = (workshop.file("program.elf"), workshop.file("made.bin"), workshop.file("espflash.txt"));
    fs::write(&elf, b"\x7FELF and so on").unwrap();
    fs::write(&made, &image).unwrap();
    let espflash = workshop.file("espflash");
    let script = format!(
        "#!/bin/sh\necho \"$@\" >> {}\nfor last; do :; done\ncp {} \"$last\"\n",
        said.display(),
        made.display()
    );
    fs::write(&espflash, script).unwrap();
    fs::set_permissions(&espflash, PermissionsExt::from_mode(0o755)).unwrap();
    fs::create_dir_all(workshop.store()).unwrap();
    let update = || {
        let mut command = thermokin();
        command
            .args(["board", "update", "--board=0", "--no-wait", "--image"])
            .arg(&elf)
            .arg("--espflash")
            .arg(&espflash);
        command.arg("--store").arg(workshop.store()).arg("--registry").arg(workshop.registry());
        command.output().unwrap()
    };
    let output = update();
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && words.contains("no logger is running on this store"), "{words}");
    // In the logger's place.
    let logger = std::os::unix::net::UnixDatagram::bind(workshop.store().join("control.sock")).unwrap();
    let output = update();
    assert!(output.status.success(), "{output:?}");
    assert!(String::from_utf8(output.stdout).unwrap().contains("version 0.3.1 is offered to 1 boards"));
    let mut wish = [0; 512];
    let length = logger.recv(&mut wish).unwrap();
    let wish = std::str::from_utf8(&wish[..length]).unwrap();
    let fields: Vec<_> = wish.splitn(5, ' ').collect();
    assert_eq!((fields[0], fields[1], fields[3]), ("update", "0", "300"), "{wish}");
    let program = fs::read(fields[4]).unwrap();
    assert!(program.starts_with(b"TKPG") && program.ends_with(&image), "{wish}");
    let said = fs::read_to_string(&said).unwrap();
    assert!(said.starts_with("save-image --chip esp32c3 --flash-size 4mb "), "{said}");
}

#[test]
fn without_espflash_it_says_how_to_install_it() {
    let workshop = Workshop::new("flash_without", 1, 1000, 1, "live");
    let image = workshop.file("image");
    fs::write(&image, "an image").unwrap();
    let mut command = thermokin();
    command.args(["board", "flash", "--port=none", "--espflash=/nowhere/espflash", "--image"]).arg(&image);
    let output = command.args(page_arguments(&workshop)).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let words = String::from_utf8(output.stderr).unwrap();
    assert!(words.contains("is not installed: cargo install espflash"), "{words}");
}
