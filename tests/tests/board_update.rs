//! New programs over the air, end to end: `thermokin board update`, the logger, and the board in the emulator with a
//! flash chip beside it. The processor's own flash cannot be programmed there, so the test plays the bootloader: it
//! starts the emulator with what the chip's otadata chooses.

mod board_support;

use std::fs;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use board_support::{Emulator, PATIENCE, Workshop, image, thermokin};
use thermokin_protocol::Configuration;

/// The most that the stack may take: 14 KiB without an update, 6 more while a signature is verified. Who must raise it says
/// why. The ESP32-C3 leaves 36 KiB (board_images.rs).
const MOST_STACK: u32 = 22 * 1024;
/// What the start-up code fills the stack with.
const PAINT: [u8; 4] = 0xCCCC_CCCC_u32.to_le_bytes();
/// A restart ends the emulator, so that the test can play the bootloader; the flash chip is reached by semihosting.
const OPTIONS: [&str; 4] = ["-action", "reboot=shutdown", "-semihosting-config", "enable=on,target=native"];

/// A workshop with one board that takes programs over the air.
struct Bench {
    workshop: Workshop,
    update_key: [u8; 32],
}

impl Bench {
    fn new(name: &str) -> Self {
        let workshop = Workshop::new(name, 1, 500, 1, "live");
        let mut options = fs::File::options();
        let mut key = options.write(true).create(true).mode(0o600).open(workshop.file("update.key")).unwrap();
        writeln!(key, "{}", "09".repeat(32)).unwrap();
        // The configuration that a real board would get says what the key's public half is.
        let page = workshop.file("real.page");
        let mut config = thermokin();
        config.args(["board", "config", "--board=0", "--host=logger.local", "--ssid=cell", "--out"]).arg(&page);
        let done = config.arg("--registry").arg(workshop.registry()).output().unwrap();
        assert!(done.status.success(), "{done:?}");
        let update_key = Configuration::from_page(&fs::read(page).unwrap()).unwrap().update_key.unwrap();
        fs::write(workshop.file("flash.bin"), image::new_chip(&image::program())).unwrap();
        Self { workshop, update_key }
    }

    /// What the bootloader does.
    fn boot(&self) -> Emulator {
        let chip = self.chip();
        let program = self.workshop.file("started.bin");
        fs::write(&program, image::in_slot(&chip, image::chosen_slot(&chip))).unwrap();
        let configuration = Configuration { update_key: Some(self.update_key), ..self.workshop.configuration(0) };
        self.workshop.start_program(&configuration, &program, &OPTIONS)
    }

    fn chip(&self) -> Vec<u8> {
        fs::read(self.workshop.file("flash.bin")).unwrap()
    }

    /// `thermokin board update` with another program, which runs like the first.
    fn update(&self, patience_s: u16) -> Update {
        let file = self.workshop.file("new.bin");
        fs::write(&file, self.new_program()).unwrap();
        let mut command = thermokin();
        command.args(["board", "update", "--board=0", "--target=emulated", "--program-version=0.2.0", "--json=-"]);
        command.arg(format!("--patience={patience_s}")).arg("--image").arg(file);
        command.arg("--store").arg(self.workshop.store()).arg("--registry").arg(self.workshop.registry());
        Update(command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap())
    }

    /// Waits until the board has written some bytes of the new program, and has it stand still there.
    fn pause_when_received(&self, board: &mut Emulator, bytes: usize) {
        let begin = Instant::now();
        while image::written(&self.chip(), 1) < bytes {
            assert!(begin.elapsed() < PATIENCE, "{bytes} bytes are not received within {PATIENCE:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
        board.pause();
        let received = image::written(&self.chip(), 1);
        println!("stopped with {received} bytes of {} received", self.new_program().len());
        assert!(received < self.new_program().len(), "all was received before the board could be stopped");
    }

    /// Another program that runs like the first, as long as a slot takes.
    fn new_program(&self) -> Vec<u8> {
        let mut program = image::program();
        program.resize(image::SLOT_LENGTH, 0x5A);
        program
    }
}

/// A `thermokin board update` that waits for the board.
struct Update(Child);

impl Update {
    /// Whether it ended well, and its words.
    fn end(mut self) -> (bool, String) {
        let begin = Instant::now();
        while self.0.try_wait().unwrap().is_none() {
            assert!(begin.elapsed() < PATIENCE, "the update does not end within {PATIENCE:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
        let child = std::mem::replace(&mut self.0, Command::new("true").spawn().unwrap());
        let output = child.wait_with_output().unwrap();
        (output.status.success(), String::from_utf8([output.stdout, output.stderr].concat()).unwrap())
    }
}

impl Drop for Update {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// How much of the stack was ever used.
fn stack_used(board: &mut Emulator, bench: &Bench) -> u32 {
    let stack = image::stack();
    let memory = board.memory(stack.start, stack.len() as u32, &bench.workshop.file("stack.bin"));
    assert_eq!(memory.len(), stack.len());
    let untouched = memory.chunks_exact(4).take_while(|word| *word == PAINT).count() as u32 * 4;
    assert!(untouched > 0, "the whole stack was used, or it was never painted");
    println!("stack: {} of {} bytes used", stack.len() as u32 - untouched, stack.len());
    stack.len() as u32 - untouched
}

#[test]
fn a_new_program_goes_over_the_air_and_stays() {
    let bench = Bench::new("update");
    let logger = bench.workshop.logger(None);
    let mut board = bench.boot();
    bench.workshop.wait_for_readings(0, 4);
    let before = stack_used(&mut board, &bench);
    let update = bench.update(60);
    // By then it has verified the signature, and written flash.
    bench.pause_when_received(&mut board, 20_000);
    let used = stack_used(&mut board, &bench);
    assert!(used > before, "the update takes no stack, so it is not what was measured");
    assert!(used <= MOST_STACK, "{used} bytes of stack, bound {MOST_STACK}");
    board.go_on();
    board.wait_for_restart("the new program");
    assert_eq!(image::chosen_slot(&bench.chip()), 1);
    let board = bench.boot();
    let (well, words) = update.end();
    assert!(well && words.contains("\"installed\": true"), "{words}");
    let before = bench.workshop.readings(None)["L0S0"].len();
    bench.workshop.wait_for_readings(0, before + 4);
    drop(board);
    // It stays after the next reset as well.
    let _board = bench.boot();
    assert_eq!(image::chosen_slot(&bench.chip()), 1);
    let before = bench.workshop.readings(None)["L0S0"].len();
    bench.workshop.wait_for_readings(0, before + 4);
    logger.stop();
    let (well, words) = bench.workshop.doctor();
    assert!(well, "{words}");
}

#[test]
fn a_transfer_survives_a_loss_of_power_and_a_program_without_a_host_is_gone_back_from() {
    let bench = Bench::new("rollback");
    let logger = bench.workshop.logger(None);
    let mut board = bench.boot();
    bench.workshop.wait_for_readings(0, 2);
    let update = bench.update(10);
    bench.pause_when_received(&mut board, 30_000);
    // Dropping it is a loss of power.
    drop(board);
    let board = bench.boot();
    board.wait_for_restart("the rest of the transfer");
    assert_eq!(image::chosen_slot(&bench.chip()), 1);
    logger.kill();
    // Three starts without a host; at the fourth it goes back.
    for start in 1..=4 {
        assert_eq!(image::chosen_slot(&bench.chip()), 1, "start {start}");
        bench.boot().wait_for_restart(&format!("start {start} without a host"));
    }
    assert_eq!(image::chosen_slot(&bench.chip()), 0, "the earlier program");
    let logger = bench.workshop.logger(None);
    let _board = bench.boot();
    let (well, words) = update.end();
    assert!(!well && words.contains("rolled back"), "{words}");
    let before = bench.workshop.readings(None)["L0S0"].len();
    bench.workshop.wait_for_readings(0, before + 4);
    logger.stop();
}

#[test]
fn a_program_of_another_key_is_refused() {
    let bench = Bench::new("update_forged");
    let logger = bench.workshop.logger(None);
    let _board = bench.boot();
    bench.workshop.wait_for_readings(0, 2);
    fs::write(bench.workshop.file("update.key"), "0a".repeat(32)).unwrap();
    let (well, words) = bench.update(60).end();
    assert!(!well && words.contains("is not signed with the key"), "{words}");
    assert_eq!(image::chosen_slot(&bench.chip()), 0);
    logger.stop();
}

#[test]
fn a_board_without_a_second_slot_says_so() {
    let bench = Bench::new("update_no_slot");
    let logger = bench.workshop.logger(None);
    let _board = bench.workshop.board(0);
    bench.workshop.wait_for_readings(0, 2);
    let (well, words) = bench.update(60).end();
    assert!(!well && words.contains("no room for a second program"), "{words}");
    logger.stop();
}
