//! The link board in the emulator and the real `thermokin log`, each a process that a test starts and stops.
#![allow(dead_code, reason = "each test binary uses its part")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

pub mod image;

use serde_json::{Value, json};
use thermokin_protocol::{Configuration, Key, Sensor, SensorKind};

pub const REPOSITORY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
const SENSORS: usize = 4;
const FIRST_ADDRESS: u8 = 0x48;
/// Where the emulated board looks for its configuration.
const CONFIGURATION_PAGE: u32 = 0x0003_FC00;
/// The longest that anything here may take on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A test's folder, with the registry of its boards, the description of its robot and the logger's store; it is kept for
/// whoever wants to see why a test failed, and emptied when the test runs again.
pub struct Workshop {
    folder: PathBuf,
    port: u16,
    boards: u32,
}

impl Workshop {
    /// A folder for `boards` boards of four sensors, sampling each `period_ms`.
    pub fn new(name: &str, boards: u32, period_ms: u32, batch_length: u16, power: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        // The port was free a moment ago; nobody else on this machine asks for ports in this range meanwhile.
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut registry = format!(
            "format = 1\n[settings]\nrevision = 1\nsampling_period_ms = {period_ms}\nbatch_length = {batch_length}\npower = \"{power}\"\n"
        );
        let mut robot = "format = 1\nname = \"bench\"\n[[transform]]\nconvention = \"dh\"\nd = 0.0\ntheta = 0.0\na = 1.0\nalpha = 0.0\n"
            .to_owned();
        for board in 0..boards {
            let addresses: Vec<_> = (0..SENSORS).map(|sensor| FIRST_ADDRESS + sensor as u8).collect();
            let key: String = key(board).iter().map(|byte| format!("{byte:02x}")).collect();
            write!(
                registry,
                "[[board]]\nboard = {board}\nrobot = \"bench\"\nlink = 0\nsensors = {addresses:?}\nkey = \"{key}\"\nfirst_boot = 1\n"
            )
            .unwrap();
            robot.push_str("[[transform]]\nconvention = \"dh\"\njoint = \"revolute\"\nd = 0.0\ntheta = 0.0\na = 0.5\nalpha = 0.0\n");
        }
        robot.push_str("[[target]]\nname = \"T1\"\nposition = [0.1, 0.0, 0.0]\n");
        for board in 0..boards {
            for (sensor, name) in sensor_names(board).iter().enumerate() {
                let address = FIRST_ADDRESS + sensor as u8;
                write!(robot, "[[sensor]]\nname = \"{name}\"\nlink = {board}\nboard = {board}\naddress = {address}\n")
                    .unwrap();
            }
        }
        let mut options = File::options();
        options.write(true).create(true).mode(0o600);
        options.open(folder.join("boards.toml")).unwrap().write_all(registry.as_bytes()).unwrap();
        fs::write(folder.join("robot.toml"), robot).unwrap();
        Self { folder, port, boards }
    }

    /// Starts the logger; with a run's name, that run begins.
    pub fn logger(&self, run: Option<&str>) -> Logger {
        let mut command = thermokin();
        command.arg("log").arg("--plain").args(["--listen", &format!("127.0.0.1:{}", self.port)]);
        command.arg("--store").arg(self.store()).arg("--registry").arg(self.folder.join("boards.toml"));
        command.arg("--robot").arg(self.folder.join("robot.toml"));
        command.args(run.map(|run| format!("--run={run}")));
        let words = File::options().create(true).append(true).open(self.folder.join("logger.txt")).unwrap();
        command.stdin(Stdio::null()).stdout(words.try_clone().unwrap()).stderr(words);
        Logger(command.spawn().unwrap())
    }

    /// Starts a board that has its own key.
    pub fn board(&self, board: u32) -> Emulator {
        assert!(board < self.boards);
        self.board_with_key(board, Key::from_bytes(key(board)))
    }

    /// Starts a board with some key.
    pub fn board_with_key(&self, board: u32, key: Key) -> Emulator {
        self.start(&Configuration { key, ..self.configuration(board) }, &[])
    }

    /// What a board is told, with its own key.
    pub fn configuration(&self, board: u32) -> Configuration {
        let sensors =
            (0..SENSORS).map(|sensor| Sensor { address: FIRST_ADDRESS + sensor as u8, kind: SensorKind::Lm75 });
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
        Configuration {
            board,
            key: Key::from_bytes(key(board)),
            // Greater at every start of the emulator, by more than a board can be reset in between.
            first_boot: since_1970.as_secs() as u32,
            host: "10.0.2.2".try_into().unwrap(),
            port: self.port,
            sensors: sensors.collect(),
            place: "bench".try_into().unwrap(),
            wifi: None,
            update_key: None,
        }
    }

    /// Starts a board that is told something of its own, with more of the emulator's options.
    pub fn start(&self, configuration: &Configuration, options: &[&str]) -> Emulator {
        let image = Path::new(REPOSITORY).join("firmware/target/thumbv7m-none-eabi/release/emulated");
        assert!(image.exists(), "{} is not built: bash firmware/ci build", image.display());
        Emulator::start(&self.folder, configuration, &image, options)
    }

    /// Starts a board with another program.
    pub fn start_program(&self, configuration: &Configuration, program: &Path, options: &[&str]) -> Emulator {
        Emulator::start(&self.folder, configuration, program, options)
    }

    /// The registry.
    pub fn registry(&self) -> PathBuf {
        self.folder.join("boards.toml")
    }

    /// What `thermokin board list` says of a board.
    pub fn listed(&self, board: usize) -> Value {
        let mut command = thermokin();
        command.args(["board", "list", "--json", "-", "--store"]).arg(self.store());
        let output = command.arg("--registry").arg(self.registry()).output().unwrap();
        let listed: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&output.stderr)));
        listed["boards"][board].clone()
    }

    /// Waits until `thermokin board list` says something of board 0.
    ///
    /// # Panics
    ///
    /// When it does not within [`PATIENCE`].
    pub fn wait_until_listed(&self, what: &str, satisfied: impl Fn(&Value) -> bool) -> Value {
        let begin = Instant::now();
        loop {
            let listed = self.listed(0);
            if satisfied(&listed) {
                return listed;
            }
            assert!(begin.elapsed() < PATIENCE, "{what}: not within {PATIENCE:?}, but {listed}");
            sleep(Duration::from_millis(200));
        }
    }

    /// The readings that are stored: for each sensor, times in seconds and counts, in order.
    pub fn readings(&self, run: Option<&str>) -> BTreeMap<String, Vec<(f64, i32)>> {
        let mut command = thermokin();
        command.args(["log", "export"]).arg(self.store()).args(run.map(|run| format!("--run={run}")));
        let output = command.output().unwrap();
        let mut readings: BTreeMap<String, Vec<(f64, i32)>> = BTreeMap::new();
        for line in String::from_utf8(output.stdout).unwrap().lines().skip(1) {
            let fields: Vec<_> = line.split(',').collect();
            let [time, sensor, celsius] = fields[..] else { panic!("a line of {} fields: {line}", fields.len()) };
            let counts = celsius.parse::<f64>().unwrap() * 256.0;
            assert!((counts - counts.round()).abs() < 1e-6, "{celsius} °C is no whole number of counts");
            readings.entry(sensor.to_owned()).or_default().push((time.parse().unwrap(), counts.round() as i32));
        }
        readings
    }

    /// Waits until the store satisfies something.
    ///
    /// # Panics
    ///
    /// When it does not within [`PATIENCE`].
    pub fn wait_until(&self, what: &str, satisfied: impl Fn(&BTreeMap<String, Vec<(f64, i32)>>) -> bool) {
        let begin = Instant::now();
        while !self.store().exists() || !satisfied(&self.readings(None)) {
            assert!(begin.elapsed() < PATIENCE, "{what}: not within {PATIENCE:?}; see {}", self.folder.display());
            sleep(Duration::from_millis(200));
        }
    }

    /// Waits until each sensor of a board has at least this many readings.
    pub fn wait_for_readings(&self, board: u32, count: usize) {
        self.wait_until(&format!("{count} readings of board {board}"), |readings| {
            sensor_names(board).iter().all(|name| readings.get(name).is_some_and(|readings| readings.len() >= count))
        });
    }

    /// What `thermokin log doctor` says of the store, and whether it found all well.
    pub fn doctor(&self) -> (bool, String) {
        let output = thermokin().args(["log", "doctor"]).arg(self.store()).output().unwrap();
        let words = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8(words).unwrap())
    }

    /// How many records the loggers that were stopped have told to be lost.
    pub fn records_lost(&self) -> u64 {
        let words = fs::read_to_string(self.folder.join("logger.txt")).unwrap();
        let tallies = words.lines().filter_map(|line| line.split_once(" records told as lost"));
        let lost: Vec<u64> = tallies.map(|(before, _)| before.rsplit(' ').next().unwrap().parse().unwrap()).collect();
        assert!(!lost.is_empty(), "no logger has ended with a tally: {words}");
        lost.iter().sum()
    }

    /// A file of the test's own.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The folder of the logger's files.
    pub fn store(&self) -> PathBuf {
        self.folder.join("log")
    }
}

/// The names of a board's sensors.
pub fn sensor_names(board: u32) -> [String; SENSORS] {
    std::array::from_fn(|sensor| format!("L{board}S{sensor}"))
}

fn key(board: u32) -> [u8; 32] {
    std::array::from_fn(|index| (board as u8).wrapping_mul(31).wrapping_add(index as u8))
}

/// The binary of the workspace that this test belongs to.
pub fn thermokin() -> Command {
    let test = std::env::current_exe().unwrap();
    let binary = test.ancestors().nth(2).unwrap().join("thermokin");
    assert!(binary.exists(), "{} is not built: cargo build --package thermokin", binary.display());
    Command::new(binary)
}

/// A logger that runs.
pub struct Logger(Child);

impl Logger {
    /// Kills it as a loss of power would, without a word.
    pub fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }

    /// Ends it as a user would.
    pub fn stop(mut self) {
        let ended = Command::new("kill").args(["-INT", &self.0.id().to_string()]).status().unwrap();
        assert!(ended.success());
        assert!(self.0.wait().unwrap().success(), "the logger failed");
    }
}

impl Drop for Logger {
    fn drop(&mut self) {
        // A test that failed leaves no process behind; one that ended it has nothing left to kill.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A board that runs in QEMU.
pub struct Emulator {
    process: Child,
    monitor: BufReader<UnixStream>,
}

impl Emulator {
    fn start(folder: &Path, configuration: &Configuration, image: &Path, options: &[&str]) -> Self {
        let board = configuration.board;
        let page = folder.join(format!("board{board}.page"));
        fs::write(&page, configuration.to_page()).unwrap();
        let socket = folder.join(format!("board{board}.qmp"));
        let _ = fs::remove_file(&socket);
        let mut command = Command::new("qemu-system-arm");
        command
            // It stands still until the monitor is reached: a board that restarts at once may end the emulator before.
            .args(["-M", "lm3s6965evb", "-display", "none", "-monitor", "none", "-nic", "user", "-S"])
            .arg("-kernel")
            .arg(image);
        command.arg("-device").arg(format!("loader,file={},addr={CONFIGURATION_PAGE},force-raw=on", page.display()));
        command.arg("-qmp").arg(format!("unix:{},server=on,wait=off", socket.display()));
        command.arg("-serial").arg(format!("file:{}", folder.join(format!("board{board}.defmt")).display()));
        for sensor in 0..SENSORS {
            command.arg("-device").arg(format!("tmp105,address={},id=s{sensor}", FIRST_ADDRESS + sensor as u8));
        }
        // What the emulator itself looks for, its flash chip and its debugger's socket, lies in the test's folder too.
        command.current_dir(folder).args(options);
        let words = File::create(folder.join(format!("board{board}.qemu"))).unwrap();
        command.stdin(Stdio::null()).stdout(words.try_clone().unwrap()).stderr(words);
        let process = command.spawn().unwrap_or_else(|error| {
            panic!("qemu-system-arm: {error}: install it (apt-get install qemu-system-arm, or bash firmware/ci build)")
        });
        let begin = Instant::now();
        let monitor = loop {
            match UnixStream::connect(&socket) {
                Ok(stream) => break stream,
                Err(error) => assert!(begin.elapsed() < PATIENCE, "QEMU's monitor: {error}"),
            }
            sleep(Duration::from_millis(20));
        };
        let mut emulator = Self { process, monitor: BufReader::new(monitor) };
        emulator.answer();
        emulator.order("qmp_capabilities", json!({}));
        emulator.go_on();
        emulator
    }

    /// Sets what a sensor measures, in counts of 1/256 °C; the emulated part has 12 bits, so they are multiples of 16.
    pub fn set_counts(&mut self, sensor: usize, counts: i32) {
        assert_eq!(counts % 16, 0, "finer than the emulated sensor");
        // The emulator rounds millidegrees down to counts.
        let millidegrees = (counts * 1000 + 128).div_euclid(256);
        self.set(sensor, "temperature", json!(millidegrees));
    }

    /// Takes a sensor off the bus: it answers at an address where nobody asks.
    pub fn take_off(&mut self, sensor: usize) {
        self.move_to(sensor, 0x10 + sensor as u8);
    }

    /// Puts a sensor back on the bus; like a part whose supply came back it has forgotten everything.
    pub fn put_back(&mut self, sensor: usize) {
        self.move_to(sensor, FIRST_ADDRESS + sensor as u8);
    }

    /// Presses the reset button.
    pub fn reset(&mut self) {
        self.order("system_reset", json!({}));
    }

    /// Has the board stand still, its clock too.
    pub fn pause(&mut self) {
        self.order("stop", json!({}));
    }

    /// Has it go on.
    pub fn go_on(&mut self) {
        self.order("cont", json!({}));
    }

    /// Waits until the board has switched the emulator off by a restart; only for one that was started with
    /// `-action reboot=shutdown`.
    ///
    /// # Panics
    ///
    /// When that does not come within [`PATIENCE`].
    pub fn wait_for_restart(mut self, what: &str) {
        let begin = Instant::now();
        while self.process.try_wait().unwrap().is_none() {
            assert!(begin.elapsed() < PATIENCE, "{what}: no restart within {PATIENCE:?}");
            sleep(Duration::from_millis(50));
        }
    }

    /// What lies in the board's memory.
    pub fn memory(&mut self, from: u32, length: u32, file: &Path) -> Vec<u8> {
        self.order("pmemsave", json!({"val": from, "size": length, "filename": file}));
        fs::read(file).unwrap()
    }

    fn move_to(&mut self, sensor: usize, address: u8) {
        self.set(sensor, "realized", json!(false));
        self.set(sensor, "address", json!(address));
        self.set(sensor, "realized", json!(true));
    }

    fn set(&mut self, sensor: usize, property: &str, value: Value) {
        let path = format!("/machine/peripheral/s{sensor}");
        self.order("qom-set", json!({"path": path, "property": property, "value": value}));
    }

    fn order(&mut self, command: &str, arguments: Value) {
        writeln!(self.monitor.get_mut(), "{}", json!({"execute": command, "arguments": arguments})).unwrap();
        let answer = loop {
            let answer = self.answer();
            if answer.get("event").is_none() {
                break answer;
            }
        };
        assert!(answer.get("return").is_some(), "QEMU refused {command}: {answer}");
    }

    fn answer(&mut self) -> Value {
        let mut line = String::new();
        self.monitor.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("QEMU said {line:?}: {error}"))
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
