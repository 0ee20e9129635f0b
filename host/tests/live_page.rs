//! The live page as a person sees it: virtual boards speak to the real logger, which serves the page to a browser.

mod browser;

use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;

use browser::{Browser, LOOKS};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde_json::Value;
use thermokin::live::{Feed, Server};
use thermokin::logger::engine::Engine;
use thermokin::logger::registry::{Board, Registry};
use thermokin::logger::serve::State;
use thermokin_protocol::{
    BoardLink, Firmware, Identity, Key, MAX_DATAGRAM, Reading, ResetReason, Sensor, SensorKind, Settings,
};

const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/comau-nj-130-2.0.toml");
/// Where the drift is looked at, degrees.
const POSTURE: &str = "0,-20,-70,0,45,0";

/// A process that ends with the test.
struct Running(Child);

impl Running {
    /// Asks it to end, as a person at the terminal does, and waits until it has.
    fn end(mut self) {
        let asked = Command::new("kill").args(["-INT", &self.0.id().to_string()]).status().expect("kill");
        assert!(asked.success());
        assert!(self.0.wait().expect("it ends").success());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn thermokin(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_thermokin"));
    command.current_dir(folder).args(arguments);
    command
}

fn done(folder: &Path, arguments: &[&str]) -> String {
    let output = thermokin(folder, arguments).output().expect("the binary");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Virtual boards on the robot, known to the logger.
fn boards(host: &str, duration: &str) -> Vec<String> {
    let fixed = "board virtual --registry boards.toml --seed 7 --rate 10 --batch 2 --speed 60 --drain 5 --robot";
    let more = [ROBOT, "--host", host, "--duration", duration];
    fixed.split(' ').chain(more).map(str::to_owned).collect()
}

fn words(arguments: &[String]) -> Vec<&str> {
    arguments.iter().map(String::as_str).collect()
}

/// A logger with a live page: the process, where boards speak to it, where the page is.
fn logger(folder: &Path, more: &[&str]) -> (Running, String, String) {
    done(folder, &words(&boards("127.0.0.1:1", "0")));
    let fixed = ["log", "--plain", "--listen", "127.0.0.1:0", "--registry", "boards.toml", "--run", "warm-up"];
    let mut command = thermokin(folder, &[&fixed[..], &["--robot", ROBOT], more].concat());
    let mut process = command.stderr(Stdio::piped()).stdout(Stdio::null()).spawn().expect("the logger");
    let mut lines = BufReader::new(process.stderr.take().expect("piped")).lines();
    let (mut listening, mut page) = (None, None);
    while listening.is_none() || page.is_none() {
        let line = lines.next().expect("the logger speaks").expect("text");
        let after = |words: &str| line.split_once(words).map(|(_, rest)| rest.to_owned());
        page = page.or(after("live page: "));
        listening = listening.or(after("listening on ").and_then(|rest| Some(rest.split_once(',')?.0.to_owned())));
    }
    // Somebody must go on reading, or the logger would wait.
    std::thread::spawn(move || lines.for_each(drop));
    (Running(process), listening.unwrap_or_default(), page.unwrap_or_default())
}

/// The head of the answer to a request.
fn asked(address: &str, path: &str, host: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("it listens");
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").expect("sent");
    let mut text = String::new();
    // An answer that is cut off shows in what is missing of it.
    let _ = stream.take(2000).read_to_string(&mut text);
    text
}

/// The cells of a table, row by row.
fn cells(browser: &mut Browser, table: &str) -> Vec<Vec<String>> {
    let script =
        format!("[...document.querySelectorAll('#{table} tr')].map((r) => [...r.children].map((c) => c.textContent))");
    serde_json::from_value(browser.evaluate(&script)).expect("rows of text")
}

fn text(browser: &mut Browser, id: &str) -> String {
    browser.evaluate(&format!("document.getElementById('{id}').textContent")).as_str().expect("text").to_owned()
}

/// What a cell must say of a number of the status.
fn shown(value: &Value, decimals: usize) -> String {
    value.as_f64().map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
}

/// The drift as `thermokin compensate` computes it: the middle of the targets now, less where it is at the reference; um.
fn drift(folder: &Path, celsius: &BTreeMap<String, f64>) -> Vector3<f64> {
    let joints = POSTURE.split(',').map(|joint| joint.parse::<f64>().expect("a number").to_radians().to_string());
    let joints = joints.collect::<Vec<_>>().join(",");
    std::fs::write(folder.join("posture.csv"), format!("q1,q2,q3,q4,q5,q6\n{joints}\n")).expect("written");
    let model: Value =
        serde_json::from_slice(&std::fs::read(folder.join("model.json")).expect("a model")).expect("JSON");
    let known: Vec<&str> =
        model["temperatures"].as_array().expect("sensors").iter().filter_map(|t| t["sensor"].as_str()).collect();
    let targets: Vec<Vector3<f64>> = model["targets"]
        .as_array()
        .expect("targets")
        .iter()
        .map(|target| serde_json::from_value::<[f64; 3]>(target["position"].clone()).expect("a place").into())
        .collect();
    let middle = targets.iter().sum::<Vector3<f64>>() / targets.len() as f64;
    let given: Vec<String> = celsius
        .iter()
        .filter(|(name, _)| known.contains(&name.as_str()))
        .map(|(name, c)| format!("{name}={c}"))
        .collect();
    let at = |given: &[String]| {
        let mut arguments = vec!["compensate", "model.json", "--forward", "posture.csv"];
        given.iter().for_each(|given| arguments.extend(["--temperature", given]));
        let table = done(folder, &arguments);
        let (head, row) = table.split_once('\n').expect("a head");
        let named: HashMap<&str, f64> = head
            .split(',')
            .zip(row.trim().split(','))
            .filter_map(|(name, cell)| Some((name, cell.parse().ok()?)))
            .collect();
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(named["qw"], named["qx"], named["qy"], named["qz"]));
        Vector3::new(named["x_m"], named["y_m"], named["z_m"]) + turn * middle
    };
    1e6 * (at(&given) - at(&[]))
}

#[test]
fn the_live_page_shows_what_is_logged_and_what_the_model_makes_of_it() {
    println!("boards with seed 7, scenario small with its own seed");
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    done(folder, &["simulate", "small", "--out", "run"]);
    done(folder, &["calibrate", "run", "--out", "model.json"]);
    let more = ["--http", "127.0.0.1:0", "--model", "model.json", "--posture", POSTURE];
    let (logger, listening, page) = logger(folder, &more);
    let address = page.trim_start_matches("http://").trim_end_matches('/').to_owned();

    // Only a local name is answered: a page from elsewhere whose name leads here learns nothing.
    assert!(asked(&address, "/", &address).starts_with("HTTP/1.1 200"));
    assert!(asked(&address, "/", "localhost:9").starts_with("HTTP/1.1 200"), "through a tunnel");
    assert!(asked(&address, "/", "evil.example").starts_with("HTTP/1.1 403"));
    assert!(asked(&address, "/nothing", &address).starts_with("HTTP/1.1 404"));

    let mut browser = Browser::start();
    browser.look(1280, "light");
    browser.open(&page, "document.getElementById('alarms').textContent.includes('No board has been heard yet')");
    assert!(text(&mut browser, "alarms").contains(&listening), "where boards are waited for");

    let arguments = boards(&listening, "20");
    let taking = Running(
        thermokin(folder, &words(&arguments)).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("boards"),
    );
    browser.wait(
        "document.querySelectorAll('#sensors tr').length >= 16 && document.getElementById('alarms').textContent === ''",
    );
    let sensors = cells(&mut browser, "sensors").len();
    for row in cells(&mut browser, "sensors") {
        let celsius: f64 = row[2].parse().unwrap_or_else(|_| panic!("{row:?}"));
        assert!((15.0..45.0).contains(&celsius) && row[0].starts_with("link") && row[5] == "read", "{row:?}");
    }
    // Sixty times as fast as an arm warms: the drift moves.
    browser.wait("Number(document.getElementById('drift-length').textContent) > 5");
    let before = browser.evaluate("document.getElementById('drift-axes').textContent");
    let stand = |degrees: &str| {
        format!(
            "document.querySelectorAll('#joints input')[1].value = '{degrees}'; document.querySelector('#posture button').click(); 0"
        )
    };
    browser.evaluate(&stand("40"));
    browser.wait(&format!("document.getElementById('drift-axes').textContent !== {before}"));
    browser.evaluate(&stand("-20"));
    assert!(text(&mut browser, "run").starts_with("warm-up, 0 h"));
    browser.wait("Number(document.getElementById('plot').dataset.points) > 16 * 8");
    // Lines are drawn in the colours of links.
    browser.wait(
        "(() => { const c = document.querySelector('#plot canvas'); if (!c) return false; const p = new Uint32Array(
        c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer); return new Set(p).size > 20; })()",
    );
    // What a click does in the legend, a key does as well.
    browser.evaluate("document.querySelector('#plot th[role=button]').focus(); 0");
    browser.press("Enter", 13);
    browser.wait("document.querySelectorAll('#plot .u-legend .u-off').length === 1");
    browser.press("Enter", 13);
    browser.wait("document.querySelectorAll('#plot .u-legend .u-off').length === 0");
    for (width, scheme) in LOOKS {
        browser.look(width, scheme);
        let drawn = browser.evaluate("Number(document.documentElement.dataset.states)");
        browser.wait(&format!("Number(document.documentElement.dataset.states) > {drawn} + 5"));
        let found = browser.axe();
        assert!(found.is_empty(), "{width} pixels, {scheme}:\n{}", found.join("\n"));
        let wider = browser.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth");
        assert_eq!(wider, 0, "{width} pixels: the page is wider than the window");
        browser.picture(&format!("live-{width}-{scheme}"));
    }
    browser.look(1280, "light");

    // The boards end: the page says which are silent and since when, and what it shows is what the logger's status says.
    drop(taking);
    browser
        .wait("document.querySelectorAll('#boards tr.old').length === document.querySelectorAll('#boards tr').length");
    browser.wait(
        "document.querySelectorAll('#sensors tr.old').length === document.querySelectorAll('#sensors tr').length",
    );
    let alarms = text(&mut browser, "alarms");
    assert!(alarms.starts_with("Boards 0, 1, 2, 3, 4 are silent: the last of them was heard at "), "{alarms}");
    browser.picture("live-silent");
    let status: Value =
        serde_json::from_slice(&std::fs::read(folder.join("thermokin-log/status.json")).expect("written"))
            .expect("JSON");
    let told = status["boards"].as_array().expect("boards");
    let celsius: BTreeMap<String, f64> = told
        .iter()
        .flat_map(|board| board["sensors"].as_array().expect("sensors"))
        .map(|sensor| {
            (sensor["sensor"].as_str().expect("a name").to_owned(), sensor["celsius"].as_f64().expect("a number"))
        })
        .collect();
    let rows = cells(&mut browser, "sensors");
    assert_eq!((rows.len(), celsius.len()), (sensors, sensors));
    for row in rows {
        assert_eq!(
            (row[2].as_str(), row[5].as_str()),
            (format!("{:.2}", celsius[&row[1]]).as_str(), "silent"),
            "{row:?}"
        );
    }
    for (row, board) in cells(&mut browser, "boards").iter().zip(told) {
        let expected = [
            shown(&board["board"], 0),
            shown(&board["battery_mv"], 0),
            shown(&board["signal_dbm"], 0),
            shown(&board["reads_failed"], 0),
            shown(&board["lost"], 0),
        ];
        assert_eq!([&row[0], &row[3], &row[4], &row[6], &row[7]], expected.each_ref());
    }
    // The drift is that of the last temperatures, and the page says so. Shown are tenths of a micrometre.
    let expected = drift(folder, &celsius);
    browser.wait("document.getElementById('drift-words').textContent.includes('Silent, taken as read last: ')");
    let axes: Vec<f64> =
        text(&mut browser, "drift-axes").split(", ").map(|axis| axis.parse().expect("a number")).collect();
    for (shown, expected) in axes.iter().zip(expected.iter()) {
        assert!((shown - expected).abs() <= 0.0501, "the page says {axes:?}, compensate {expected:?}");
    }
    let length: f64 = text(&mut browser, "drift-length").parse().expect("a number");
    assert!((length - expected.norm()).abs() <= 0.0501, "{length}, {}", expected.norm());

    // The history is what a later watcher sees, and the plots hold its points.
    browser.open(
        &page,
        "document.querySelectorAll('#sensors tr.old').length >= 16 && document.querySelector('#plot canvas')",
    );
    let counted = browser.evaluate(
        "fetch(`/history${location.search}`).then((answer) => answer.json()).then(({ names, recent }) => [names.length,
        recent.columns.flat().filter((value) => value !== null).length, recent.drift.filter((value) => value !== null).length,
        Number(document.getElementById('plot').dataset.points), Number(document.getElementById('drift-plot').dataset.points)])",
    );
    let counted: [usize; 5] = serde_json::from_value(counted).expect("numbers");
    assert_eq!(counted[0], sensors);
    assert!(counted[1] > sensors * 15 && counted[1] == counted[3], "{counted:?}");
    // The drift goes on, second by second.
    assert!(counted[2] > 15 && counted[2].abs_diff(counted[4]) <= 3, "{counted:?}");

    assert_eq!(browser.errors(), Vec::<String>::new());
    let outside: Vec<String> = browser.asked_for().into_iter().filter(|url| !url.starts_with(&page)).collect();
    assert!(outside.iter().all(|url| url.starts_with("data:")), "asked for from outside: {outside:?}");
    logger.end();
    browser.wait("document.getElementById('link').textContent.startsWith('The logger has ended')");
    browser.picture("live-ended");
    assert_eq!(browser.errors(), Vec::<String>::new());
}

#[test]
fn a_logger_that_is_killed_is_told_from_one_that_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let (logger, _, page) = logger(folder.path(), &["--http", "127.0.0.1:0"]);
    let mut browser = Browser::start();
    browser.open(&page, "document.getElementById('link').textContent.startsWith('Connected')");
    assert_eq!(browser.evaluate("document.getElementById('drift').hidden"), true, "there is no model");
    drop(logger);
    browser.wait("document.getElementById('link').textContent.startsWith('The logger does not answer')");
}

#[test]
fn beyond_this_machine_the_page_asks_for_its_token() {
    let folder = tempfile::tempdir().expect("a folder");
    let (_logger, _, page) = logger(folder.path(), &["--http", "0.0.0.0:0"]);
    let (address, token) = page.trim_start_matches("http://").split_once("/?token=").expect("a token");
    assert!(token.len() >= 32, "{page}");
    assert!(asked(address, "/", address).starts_with("HTTP/1.1 403"));
    assert!(asked(address, "/history?token=0123456789abcdef", address).starts_with("HTTP/1.1 403"));
    let history = asked(address, &format!("/history?token={token}"), address);
    assert!(history.starts_with("HTTP/1.1 200") && history.contains("names"), "{history}");
    let mut browser = Browser::start();
    browser.open(&page, "document.getElementById('link').textContent.startsWith('Connected')");
    assert_eq!(browser.errors(), Vec::<String>::new());
}

#[test]
fn wrong_options_are_said_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    for (more, words) in [
        (&["--http", "127.0.0.1:0", "--model", "none.json"][..], "none.json: cannot be read"),
        (&["--http", "127.0.0.1:0", "--http-token", "short"], "expected 16 letters"),
    ] {
        let output = thermokin(folder, &[&["log", "--plain"], more].concat()).output().expect("the binary");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(words), "{said}");
        assert_eq!(std::fs::read_dir(folder).expect("a folder").count(), 0, "something was written");
    }
}

const START_US: u64 = 1_795_000_000_000_000;
const HOURS: u64 = 8;

/// Five boards of four sensors, whose datagrams arrive at once in a logger's engine, for as long as is asked for: time is an
/// argument of both ends, so that eight hours take no time. The feed is given the state every second.
fn eight_hours(feed: &Feed) -> (Engine, State) {
    let settings = Settings { revision: 1, sampling_period_ms: 10_000, ..Settings::default() };
    let identity =
        Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
    let addresses = [0x48, 0x49, 0x4A, 0x4B];
    let sensors = addresses.map(|address| Sensor { address, kind: SensorKind::Max30205 });
    let key = |board: u32| Key::from_bytes([board as u8; 32]);
    let place = |board| Board {
        board,
        robot: "arm".into(),
        link: board,
        sensors: addresses.to_vec(),
        key: key(board),
        first_boot: 1,
    };
    let registry = Registry { settings, boards: (0..5).map(place).collect() };
    let mut engine = Engine::new((START_US / 1_000_000) as u32, &registry, HashMap::new(), BTreeMap::new());
    let mut boards: Vec<BoardLink<64>> =
        (0..5).map(|board| BoardLink::new(board, key(board), 1, identity, &sensors, settings, 0)).collect();
    let state = State { listen: SocketAddr::from(([127, 0, 0, 1], 9)), store: "nowhere".into(), run: None, free: None };
    let mut buffer = [0; MAX_DATAGRAM];
    for second in 0..HOURS * 3600 {
        let (board_us, now_us) = (second * 1_000_000, START_US + second * 1_000_000);
        for (number, board) in boards.iter_mut().enumerate() {
            if second % 10 == 0 {
                let counts = |place: usize| 5120 + (second / 60) as i16 + (100 * number + 20 * place) as i16;
                let readings: [Reading; 4] = std::array::from_fn(|place| Reading::Ok(counts(place)));
                board.record(board_us, &readings);
            }
            while let Some(length) = board.poll(board_us, &mut buffer) {
                engine.on_datagram(state.listen, &mut buffer[..length], now_us);
            }
        }
        if engine.close_group(now_us).is_some() {
            engine.committed(now_us);
        }
        let mut answers = Vec::new();
        engine.answers(|| now_us, |_, datagram| answers.push(datagram.to_vec()));
        for answer in &mut answers {
            boards.iter_mut().for_each(|board| drop(board.receive(board_us + 1000, &mut answer.clone())));
        }
        engine.on_tick(now_us);
        feed.put(&engine, &state, now_us);
    }
    (engine, state)
}

#[test]
fn a_page_that_is_opened_after_eight_hours_shows_all_of_them() {
    let feed = Arc::new(Feed::new(HashMap::new()));
    let (engine, state) = eight_hours(&feed);
    let server = Server::start(([127, 0, 0, 1], 0).into(), None, feed.clone(), None, Vec::new()).expect("it listens");
    let mut browser = Browser::start();
    browser.look(1280, "light");
    browser.open(&server.url(), "document.querySelector('#plot canvas')");
    browser.evaluate("document.querySelector('[data-span=whole]').click(); 0");
    // The logger goes on, four times a second.
    let end_us = START_US + HOURS * 3_600_000_000;
    for tick in 0..8 {
        feed.put(&engine, &state, end_us + tick * 250_000);
        std::thread::sleep(std::time::Duration::from_millis(250));
    }
    let history = browser.evaluate("fetch('/history').then((answer) => answer.json())");
    let rows = |part: &str| history[part]["times"].as_array().map_or(0, Vec::len);
    assert_eq!(rows("recent"), 900);
    assert!((720..=1440).contains(&rows("whole")), "{}", rows("whole"));
    let span = |part: &str| -> f64 {
        let times = history[part]["times"].as_array().expect("times");
        times[times.len() - 1].as_f64().expect("a time") - times[0].as_f64().expect("a time")
    };
    assert!(span("whole") > (HOURS * 3600 - 64) as f64, "{}", span("whole"));
    assert_eq!(history["names"].as_array().map(Vec::len), Some(20));
    let points = browser.evaluate("Number(document.getElementById('plot').dataset.points)").as_u64().expect("a number");
    let wanted = 20 * rows("whole") as u64;
    // A few rows come after the history was fetched.
    assert!((wanted..wanted + 20 * 8).contains(&points), "{points} points, {wanted} in the history");
    // Each line rises from its first counts to its last.
    for (sensor, column) in history["whole"]["columns"].as_array().expect("columns").iter().enumerate() {
        let first = 20.0 + (100 * (sensor / 4) + 20 * (sensor % 4)) as f64 / 256.0;
        let last = first + (60 * HOURS - 1) as f64 / 256.0;
        let ends = [column[0].clone(), column[rows("whole") - 1].clone()].map(|end| end.as_f64().expect("a number"));
        assert!(
            (ends[0] - first).abs() < 6e-4 && (ends[1] - last).abs() < 6e-4,
            "{sensor}: {ends:?}, {first} to {last}"
        );
    }
    let bytes = history.to_string().len();
    println!("the history is {bytes} bytes");
    assert!(bytes < 2_000_000, "{bytes} bytes");
    browser.picture("live-eight-hours");
    assert_eq!(browser.errors(), Vec::<String>::new());
    drop(server);
    browser.wait("document.getElementById('link').textContent.startsWith('The logger has ended')");
}
