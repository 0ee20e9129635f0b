//! What the host is told of a board beside readings: that it is heard, why it started, a watchdog that bit; and a host
//! that is found by its name.

mod board_support;

use std::io::{Read, Write};
use std::net::{Ipv4Addr, UdpSocket};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use board_support::{PATIENCE, Workshop, image};
use thermokin_protocol::Configuration;

/// The emulator's debugger, as much of gdb's protocol as it takes to hang a program.
struct Debugger(UnixStream);

impl Debugger {
    /// Connects, which stops the processor.
    fn connect(socket: &Path) -> Self {
        let begin = Instant::now();
        loop {
            match UnixStream::connect(socket) {
                Ok(stream) => {
                    stream.set_read_timeout(Some(PATIENCE)).unwrap();
                    let mut debugger = Self(stream);
                    debugger.send("?");
                    debugger.wait_until_stopped();
                    return debugger;
                }
                Err(error) => assert!(begin.elapsed() < PATIENCE, "QEMU's debugger: {error}"),
            }
            sleep(Duration::from_millis(20));
        }
    }

    fn send(&mut self, packet: &str) {
        let sum = packet.bytes().fold(0_u8, u8::wrapping_add);
        write!(self.0, "${packet}#{sum:02x}").unwrap();
    }

    /// The next answer.
    fn answer(&mut self) -> String {
        let mut byte = || {
            let mut byte = [0];
            self.0.read_exact(&mut byte).unwrap();
            byte[0]
        };
        while byte() != b'$' {}
        let mut text = String::new();
        loop {
            match byte() {
                b'#' => break,
                other => text.push(char::from(other)),
            }
        }
        // The check's two digits.
        byte();
        byte();
        self.0.write_all(b"+").unwrap();
        text
    }

    fn wait_until_stopped(&mut self) {
        while !self.answer().starts_with('T') {}
    }

    /// The answer to a packet; that the processor stands still may be told in between.
    fn ask(&mut self, packet: &str) -> String {
        self.send(packet);
        loop {
            let answer = self.answer();
            if !answer.starts_with('T') {
                return answer;
            }
        }
    }

    /// Has the program go round in circles for ever, in its tasks: interrupts still come through.
    fn hang(mut self, address: u32) {
        const PROGRAM_COUNTER: u32 = 15;
        const STATUS: u32 = 25;
        // QEMU gives single registers only to who has asked what registers there are.
        self.ask("qXfer:features:read:target.xml:0,ffb");
        // It stops when the debugger connects; where an interrupt is just being served it is let run on.
        let begin = Instant::now();
        loop {
            let status = u32::from_str_radix(&self.ask(&format!("p{STATUS:x}")), 16).unwrap().swap_bytes();
            if status & 0x1FF == 0 {
                break;
            }
            assert!(begin.elapsed() < PATIENCE, "always in an interrupt: {status:x}");
            self.send("c");
            sleep(Duration::from_millis(7));
            self.0.write_all(&[3]).unwrap();
            self.wait_until_stopped();
        }
        assert_eq!(self.ask(&format!("P{PROGRAM_COUNTER:x}={:08x}", address.swap_bytes())), "OK");
        assert_eq!(self.ask("D"), "OK");
    }
}

#[test]
fn the_host_is_told_that_a_board_is_heard_and_why_it_started() {
    let workshop = Workshop::new("health", 2, 500, 1, "live");
    let logger = workshop.logger(None);
    let gdb = format!("unix:{},server=on,wait=off", workshop.file("gdb").display());
    let mut board = workshop.start(&workshop.configuration(0), &["-gdb", &gdb]);
    let after = |reason: &'static str| move |listed: &serde_json::Value| listed["status"]["reset"] == reason;
    let listed = workshop.wait_until_listed("power on", after("power on"));
    assert_eq!(listed["heard"], true, "{listed}");
    assert_eq!(listed["status"]["firmware"], "0.1.0", "{listed}");
    assert!(workshop.listed(1)["heard"] == false && workshop.listed(1)["status"].is_null(), "{}", workshop.listed(1));
    let first = listed["status"]["boot"].as_u64().unwrap();
    board.reset();
    workshop.wait_until_listed("the reset pin", after("reset pin"));
    // A program that hangs is not told from here: the watchdog's first half notes why, its second half resets.
    Debugger::connect(&workshop.file("gdb")).hang(image::endless_loop());
    let listed = workshop.wait_until_listed("the watchdog", after("watchdog"));
    assert_eq!(listed["status"]["boot"].as_u64().unwrap(), first + 2, "{listed}");
    // A board that is gone is silent after ten seconds, and was heard.
    drop(board);
    let listed = workshop.wait_until_listed("silence", |listed| listed["heard"] == false);
    assert!(listed["status"]["heard_us"].is_u64(), "{listed}");
    logger.stop();
}

#[test]
fn a_host_is_found_by_its_name() {
    let workshop = Workshop::new("mdns", 1, 500, 1, "live");
    let name = format!("thermokin-{}", std::process::id());
    let stop = Arc::new(AtomicBool::new(false));
    let responder = respond(name.clone(), Ipv4Addr::new(10, 0, 2, 2), Arc::clone(&stop));
    let logger = workshop.logger(None);
    let host = format!("{name}.local").as_str().try_into().unwrap();
    let _board = workshop.start(&Configuration { host, ..workshop.configuration(0) }, &[]);
    workshop.wait_for_readings(0, 4);
    logger.stop();
    stop.store(true, Ordering::Relaxed);
    assert!(responder.join().unwrap() > 0, "the board did not ask by multicast");
}

/// Answers multicast questions for a name in `.local`, until it is stopped; gives how many it answered. The emulator's
/// network sends the board's multicast out of this machine's own sockets, where it loops back.
fn respond(name: String, address: Ipv4Addr, stop: Arc<AtomicBool>) -> std::thread::JoinHandle<usize> {
    let socket = UdpSocket::bind("0.0.0.0:5353").expect("port 5353 is free: no other mDNS responder runs here");
    socket
        .join_multicast_v4(&Ipv4Addr::new(224, 0, 0, 251), &Ipv4Addr::UNSPECIFIED)
        .expect("a network interface that takes multicast");
    socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
    std::thread::spawn(move || {
        let mut question = vec![name.len() as u8];
        question.extend_from_slice(name.as_bytes());
        question.extend_from_slice(b"\x05local\0\0\x01");
        let (mut answered, mut buffer) = (0, [0; 1500]);
        while !stop.load(Ordering::Relaxed) {
            let Ok((length, from)) = socket.recv_from(&mut buffer) else { continue };
            let asked = buffer.get(12..12 + question.len()).is_some_and(|asked| asked == question);
            if length < 12 + question.len() + 2 || !asked {
                continue;
            }
            // The same number, an authoritative answer, one question and one answer.
            let mut answer = buffer[..2].to_vec();
            answer.extend_from_slice(&[0x84, 0, 0, 1, 0, 1, 0, 0, 0, 0]);
            answer.extend_from_slice(&question);
            answer.extend_from_slice(&[0, 1]);
            // The name again by its place, an address on the internet, for 120 s.
            answer.extend_from_slice(&[0xC0, 12, 0, 1, 0, 1, 0, 0, 0, 120, 0, 4]);
            answer.extend_from_slice(&address.octets());
            answered += usize::from(socket.send_to(&answer, from).is_ok());
        }
        answered
    })
}
