//! A headless Chromium that opens pages as a person's browser would, driven over a pipe by the DevTools protocol: nothing
//! but the browser itself is needed.
//!
//! `axe.min.js` is axe-core 4.14.1 (Mozilla Public License 2.0, its notice stands in it), unchanged from npm; it checks
//! accessibility and is part of tests only.

use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

/// How a page is looked at: the window's width and the scheme of colours.
pub const LOOKS: [(u32, &str); 3] = [(1280, "light"), (1280, "dark"), (480, "light")];

/// The names that Chromium has.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// A page that is not ready by then is not going to be, however loaded the machine.
const PATIENCE: Duration = Duration::from_secs(120);

pub struct Browser {
    process: Child,
    to: ChildStdin,
    from: BufReader<ChildStdout>,
    session: Option<String>,
    count: u64,
    events: Vec<Value>,
    _profile: tempfile::TempDir,
}

fn installed() -> &'static str {
    let there = |name: &&&str| {
        let found = Command::new("sh").arg("-c").arg(format!("command -v {name}")).stdout(Stdio::null()).status();
        found.is_ok_and(|status| status.success())
    };
    NAMES.iter().find(there).copied().unwrap_or_else(|| {
        panic!("no Chromium on this machine: install it with `apt-get install chromium`, or run .ci/setup, which does")
    })
}

impl Browser {
    /// A browser with one empty page.
    pub fn start() -> Browser {
        let profile = tempfile::tempdir().expect("a folder");
        // The protocol's pipes are the descriptors 3 and 4, which the shell makes of its own input and output.
        let mut process = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1", installed()])
            .args(["--headless", "--no-sandbox", "--disable-dev-shm-usage", "--remote-debugging-pipe"])
            // The arm in space is drawn by software where there is no graphics processor.
            .args(["--enable-unsafe-swiftshader", "--no-first-run", "--disable-extensions", "--hide-scrollbars"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("sh");
        let to = process.stdin.take().expect("piped");
        let from = BufReader::new(process.stdout.take().expect("piped"));
        let mut browser = Browser { process, to, from, session: None, count: 0, events: Vec::new(), _profile: profile };
        let begun = Instant::now();
        let target = loop {
            let targets = browser.call("Target.getTargets", json!({}));
            let pages = targets["targetInfos"].as_array().cloned().unwrap_or_default();
            if let Some(page) = pages.iter().find(|target| target["type"] == "page") {
                break page["targetId"].clone();
            }
            assert!(begun.elapsed() < PATIENCE, "the browser has no page");
        };
        let attached = browser.call("Target.attachToTarget", json!({"targetId": target, "flatten": true}));
        browser.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser
    }

    /// Calls a method of the protocol; what happens meanwhile is kept.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.count += 1;
        let mut message = json!({"id": self.count, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.to.write_all(&bytes).expect("the browser listens");
        loop {
            let mut answer = Vec::new();
            self.from.read_until(0, &mut answer).expect("the browser answers");
            assert_eq!(answer.pop(), Some(0), "the browser ended");
            let answer: Value = serde_json::from_slice(&answer).expect("JSON");
            if answer["id"] == self.count {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].clone();
            }
            self.events.push(answer);
        }
    }

    /// Evaluates JavaScript in the page; waits for a promise.
    pub fn evaluate(&mut self, script: &str) -> Value {
        let asked = json!({"expression": script, "awaitPromise": true, "returnByValue": true});
        let answer = self.call("Runtime.evaluate", asked);
        assert!(answer["exceptionDetails"].is_null(), "{script}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// Opens an address and waits until a script says true.
    pub fn open(&mut self, address: &str, ready: &str) {
        self.events.clear();
        self.call("Page.navigate", json!({"url": address}));
        self.wait(ready);
    }

    /// Waits until a script says true.
    pub fn wait(&mut self, ready: &str) {
        let begun = Instant::now();
        // What the script looks at may not be there yet.
        let asked = format!("(() => {{ try {{ return Boolean({ready}); }} catch {{ return false; }} }})()");
        while self.evaluate(&asked) != true {
            assert!(begun.elapsed() < PATIENCE, "not so after {PATIENCE:?}: {ready}");
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// The window's size and the scheme of colours.
    pub fn look(&mut self, width: u32, scheme: &str) {
        let size = json!({"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", size);
        let features = json!([{"name": "prefers-color-scheme", "value": scheme}]);
        self.call("Emulation.setEmulatedMedia", json!({"features": features}));
    }

    /// Errors that the page or the browser told in the console.
    pub fn errors(&self) -> Vec<String> {
        let is_error = |event: &&Value| match event["method"].as_str() {
            Some("Runtime.exceptionThrown") => true,
            Some("Runtime.consoleAPICalled") => event["params"]["type"] == "error",
            Some("Log.entryAdded") => event["params"]["entry"]["level"] == "error",
            _ => false,
        };
        self.events.iter().filter(is_error).map(|event| event["params"].to_string()).collect()
    }

    /// The addresses that the page asked for.
    pub fn asked_for(&self) -> Vec<String> {
        let asked = self.events.iter().filter(|event| event["method"] == "Network.requestWillBeSent");
        asked.filter_map(|event| event["params"]["request"]["url"].as_str().map(str::to_owned)).collect()
    }

    /// What axe-core finds against the page, one line each.
    pub fn axe(&mut self) -> Vec<String> {
        self.evaluate(concat!(include_str!("axe.min.js"), ";0"));
        let found = self.evaluate(
            "axe.run().then((r) => r.violations.map((v) => `${v.id} (${v.impact}): ${v.help}: ` + v.nodes.slice(0, 3)\
             .map((n) => n.html.slice(0, 200)).join(' | ')))",
        );
        found.as_array().into_iter().flatten().filter_map(|line| line.as_str().map(str::to_owned)).collect()
    }

    /// Presses a key, as `Tab` or `Enter`, of this number.
    pub fn press(&mut self, key: &str, number: u32) {
        for kind in ["rawKeyDown", "keyUp"] {
            let event = json!({"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": number});
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// Leaves a picture of the whole page for people, in `target/tmp/pages`.
    pub fn picture(&mut self, name: &str) {
        let answer = self.call("Page.captureScreenshot", json!({"captureBeyondViewport": true, "format": "png"}));
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("pages");
        std::fs::create_dir_all(&folder).expect("a folder");
        let bytes = STANDARD.decode(answer["data"].as_str().expect("a picture")).expect("base64");
        std::fs::write(folder.join(format!("{name}.png")), bytes).expect("written");
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // It may have ended by itself; there is nobody to tell.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
