//! A folder in which tests run `thermokin`, and a logger that runs there.

use std::fs::{self, File};
use std::net::UdpSocket;
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::Value;

/// The longest that anything here may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A test's folder, where commands run.
pub struct Bench(tempfile::TempDir);

impl Bench {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The program, to run there.
    pub fn thermokin(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_thermokin"));
        command.current_dir(self.0.path()).args(arguments);
        command
    }

    /// Runs the program, which must succeed.
    pub fn run(&self, arguments: &[&str]) -> Output {
        let output = self.thermokin(arguments).output().expect("it runs");
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        output
    }

    /// What a command that succeeds says as JSON.
    pub fn json(&self, arguments: &[&str]) -> Value {
        serde_json::from_slice(&self.run(&[arguments, &["--json", "-"]].concat()).stdout).expect("JSON")
    }

    /// Starts the logger on a port that was free a moment ago; its words go to `words.txt`.
    pub fn logger(&self, arguments: &[&str]) -> Logger {
        let port = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a port").port();
        let address = format!("127.0.0.1:{port}");
        let words = File::create(self.path("words.txt")).expect("it is created");
        let child = self
            .thermokin(&["log", "--plain", "--registry", "boards.toml", "--listen", &address])
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(words)
            .spawn()
            .expect("the logger starts");
        let logger = Logger { child, address, words: self.path("words.txt") };
        logger.wait_for("listening on");
        logger
    }
}

/// A logger that runs.
pub struct Logger {
    child: Child,
    pub address: String,
    words: PathBuf,
}

impl Logger {
    /// What it has said.
    pub fn words(&self) -> String {
        fs::read_to_string(&self.words).expect("it is read")
    }

    /// Waits until it says something.
    pub fn wait_for(&self, words: &str) {
        let begin = Instant::now();
        while !self.words().contains(words) {
            assert!(begin.elapsed() < PATIENCE, "no {words:?} in\n{}", self.words());
            sleep(Duration::from_millis(20));
        }
    }

    /// Ends it as a user would, and gives its words.
    pub fn stop(mut self) -> String {
        let asked = Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().expect("kill runs");
        assert!(asked.success() && self.child.wait().expect("it ends").success(), "{}", self.words());
        self.words()
    }
}

impl Drop for Logger {
    fn drop(&mut self) {
        // A test that failed leaves no process behind.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
