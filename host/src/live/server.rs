//! Serves the live page: the page itself, the history, and the state as server-sent events.
//!
//! Only what is local may ask without a token, and only by a local name: a page from elsewhere that a browser was led to
//! cannot read what is here.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use tiny_http::{Header, Method, Request, Response};

use super::drift::Predictor;
use super::feed::{Feed, Shown};
use super::history::Row;

/// So many browsers may watch at a time.
const WATCHERS: usize = 32;
/// So many threads answer requests: one browser that takes its time does not make the others wait.
const ANSWERING: usize = 4;
/// How often the server looks whether it is to end.
const PATIENCE: Duration = Duration::from_millis(200);
/// How long the end waits until watchers have heard of it.
const LAST_WORDS: Duration = Duration::from_secs(1);

const PAGE: &str = include_str!("../../assets/live/live.html");
const STYLE: &str = include_str!("../../assets/live/live.css");
const SCRIPT: &str = include_str!("../../assets/live/live.js");
const CHART: &str = include_str!("../../assets/uplot/uPlot.iife.min.js");
/// Its licence, which travels with it.
const CHART_LICENCE: &str = include_str!("../../assets/uplot/LICENSE");
const CHART_STYLE: &str = include_str!("../../assets/uplot/uPlot.min.css");

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
#[error("{address}: the live page cannot be served: {reason}")]
pub struct LiveError {
    address: SocketAddr,
    reason: String,
}

/// A server of the live page; it ends when this is dropped.
pub struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

/// What the threads of a server share.
struct Shared {
    feed: Arc<Feed>,
    predictor: Option<Predictor>,
    posture: Vec<f64>,
    token: Option<String>,
    /// The names by which a local browser asks.
    hosts: Vec<String>,
    page: String,
    /// What a browser may do with the page: run what is in it, ask here, and nothing from outside.
    policy: String,
    watchers: AtomicUsize,
    stop: AtomicBool,
}

impl Server {
    /// Serves a feed at an address; beyond this machine only to those who have the token. `posture` is where the drift is
    /// predicted unless a watcher says otherwise, radians and metres.
    ///
    /// # Errors
    /// When the address cannot be listened on, or is open to others and no token is given.
    pub fn start(
        address: SocketAddr,
        token: Option<String>,
        feed: Arc<Feed>,
        predictor: Option<Predictor>,
        posture: Vec<f64>,
    ) -> Result<Server, LiveError> {
        let fail = |reason: String| LiveError { address, reason };
        if !address.ip().is_loopback() && token.is_none() {
            return Err(fail("others can reach this address, so it needs a token".to_owned()));
        }
        let http = Arc::new(tiny_http::Server::http(address).map_err(|error| fail(error.to_string()))?);
        let address = http.server_addr().to_ip().unwrap_or(address);
        let own = match address.ip() {
            IpAddr::V4(ip) => ip.to_string(),
            IpAddr::V6(ip) => format!("[{ip}]"),
        };
        let (page, policy) = page(predictor.as_ref(), &posture);
        let shared = Arc::new(Shared {
            feed,
            predictor,
            posture,
            token,
            hosts: vec!["127.0.0.1".to_owned(), "localhost".to_owned(), "[::1]".to_owned(), own],
            page,
            policy,
            watchers: AtomicUsize::new(0),
            stop: AtomicBool::new(false),
        });
        let mut server = Server { address, shared: shared.clone(), threads: Vec::new() };
        for _ in 0..ANSWERING {
            let (http, shared) = (http.clone(), shared.clone());
            let thread = std::thread::Builder::new().name("live page".to_owned()).spawn(move || {
                while !shared.stop.load(Ordering::Relaxed) {
                    match http.recv_timeout(PATIENCE) {
                        Ok(Some(request)) => answer(request, &shared),
                        Ok(None) => {}
                        Err(_) => break,
                    }
                }
            });
            server.threads.push(thread.map_err(|error| fail(error.to_string()))?);
        }
        Ok(server)
    }

    /// Where the page is, with its token.
    pub fn url(&self) -> String {
        let host = match self.address.ip() {
            ip if ip.is_unspecified() => "localhost".to_owned(),
            IpAddr::V6(ip) => format!("[{ip}]"),
            IpAddr::V4(ip) => ip.to_string(),
        };
        let token = self.shared.token.as_ref().map_or_else(String::new, |token| format!("?token={token}"));
        format!("http://{host}:{}/{token}", self.address.port())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.feed.end();
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so itself.
            let _ = thread.join();
        }
        let begun = Instant::now();
        while self.shared.watchers.load(Ordering::Relaxed) > 0 && begun.elapsed() < LAST_WORDS {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// The page and its policy: whatever is no part of it, the browser neither runs nor asks for.
fn page(predictor: Option<&Predictor>, posture: &[f64]) -> (String, String) {
    let notes = predictor.map(Predictor::notes).unwrap_or_default();
    let settings = json!({"joints": predictor.map(Predictor::turning), "posture": posture, "notes": notes});
    let digest = |text: &str| format!("'sha256-{}'", STANDARD.encode(Sha256::digest(text)));
    let style = format!("{CHART_STYLE}\n{STYLE}");
    let policy = format!(
        "default-src 'none'; script-src {} {}; style-src {}; connect-src 'self'; img-src data:; frame-ancestors 'none'; \
         base-uri 'none'; form-action 'none'",
        digest(CHART),
        digest(SCRIPT),
        digest(&style)
    );
    let page = PAGE
        .replace("/*STYLE*/", &style)
        // Nothing in it can end the element that it stands in.
        .replace("/*SETTINGS*/", &settings.to_string().replace('<', "\\u003c"))
        .replace("/*LICENCE*/", &CHART_LICENCE.replace("--", "- -"))
        .replace("/*CHART*/", CHART)
        .replace("/*SCRIPT*/", SCRIPT);
    (page, policy)
}

/// The value of a name in an address's query.
fn query<'u>(url: &'u str, name: &str) -> Option<&'u str> {
    let (_, query) = url.split_once('?')?;
    query.split('&').filter_map(|pair| pair.split_once('=')).find(|(key, _)| *key == name).map(|(_, value)| value)
}

/// Compares in a time that does not tell where two texts differ.
fn same(given: &str, own: &str) -> bool {
    given.len() == own.len() && given.bytes().zip(own.bytes()).fold(0, |sum, (a, b)| sum | (a ^ b)) == 0
}

/// The name in a Host header: through a tunnel the port is another.
fn host(value: &str) -> &str {
    match value.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) => name,
        _ => value,
    }
}

impl Shared {
    /// Why a request is refused, if it is.
    fn refusal(&self, request: &Request) -> Option<&'static str> {
        if let Some(token) = &self.token {
            let given = query(request.url(), "token").is_some_and(|given| same(given, token));
            return (!given)
                .then_some("The address of this page ends in a token; the logger said it when it started.\n");
        }
        let asked = request.headers().iter().find(|header| header.field.equiv("Host"));
        let local = asked.is_some_and(|asked| self.hosts.iter().any(|own| own == host(asked.value.as_str())));
        (!local).then_some("This page is served to this machine alone, by a local name such as localhost.\n")
    }

    /// The joints at which a watcher wants the drift.
    fn joints(&self, url: &str) -> Vec<f64> {
        let given: Option<Vec<f64>> =
            query(url, "q").and_then(|joints| joints.split(',').map(|joint| joint.parse().ok()).collect());
        let fits = |joints: &Vec<f64>| {
            joints.len() == self.posture.len() && joints.iter().all(|joint: &f64| joint.is_finite())
        };
        given.filter(fits).unwrap_or_else(|| self.posture.clone())
    }

    /// A state as the page takes it, with the drift at a posture.
    fn told(&self, shown: &Shown, joints: &[f64]) -> Value {
        let drift = self.predictor.as_ref().and_then(|predictor| {
            let drift = predictor.drift(joints, |name| shown.newest.get(name).map(|newest| newest.celsius))?;
            let mut old: Vec<&str> =
                predictor.needed().filter(|&name| shown.newest.get(name).is_some_and(|newest| newest.old)).collect();
            old.sort_unstable();
            Some(json!({"um": drift.um, "length_um": drift.length_um, "missing": drift.missing, "old": old}))
        });
        json!({"state": shown.state, "drift": drift})
    }

    /// The history in columns, with the drift at a posture.
    fn history(&self, joints: &[f64]) -> Value {
        let (names, history) = self.feed.history();
        json!({
            "names": names,
            "recent": self.columns(&names, history.recent(), joints),
            "whole": self.columns(&names, history.whole(), joints),
        })
    }

    fn columns(&self, names: &[String], rows: &VecDeque<Row>, joints: &[f64]) -> Value {
        // A MAX30205 tells 1/256 K apart.
        let told = |celsius: f32| (f64::from(celsius) * 1e3).round() / 1e3;
        let column = |place: usize| -> Vec<Option<f64>> {
            rows.iter().map(|row| row.celsius.get(place).copied().flatten().map(told)).collect()
        };
        let mut last: Vec<Option<f32>> = vec![None; names.len()];
        let mut drift = |row: &Row| -> Option<f64> {
            last.iter_mut().zip(&row.celsius).for_each(|(last, now)| *last = now.or(*last));
            // The arm is where its last temperatures put it; of a sensor that nobody has heard, nobody knows.
            let celsius = |name: &str| last[names.iter().position(|own| own == name)?].map(f64::from);
            let drift = self.predictor.as_ref()?.drift(joints, celsius)?;
            drift.missing.is_empty().then(|| (drift.length_um * 1e3).round() / 1e3)
        };
        json!({
            "times": rows.iter().map(|row| row.time_s).collect::<Vec<_>>(),
            "columns": (0..names.len()).map(column).collect::<Vec<_>>(),
            "drift": rows.iter().map(&mut drift).collect::<Vec<_>>(),
        })
    }
}

/// Sends a whole answer; one whom it does not reach has gone.
fn give(request: Request, policy: &str, status: u16, kind: &str, body: String) {
    let mut response = Response::from_string(body).with_status_code(status);
    let headers = [
        ("Content-Type", kind),
        ("Content-Security-Policy", policy),
        ("X-Content-Type-Options", "nosniff"),
        ("Referrer-Policy", "no-referrer"),
        ("Cache-Control", "no-store"),
    ];
    for (name, value) in headers {
        if let Ok(header) = Header::from_bytes(name, value) {
            response.add_header(header);
        }
    }
    let _ = request.respond(response);
}

fn answer(request: Request, shared: &Arc<Shared>) {
    let plain = "text/plain; charset=utf-8";
    let policy = shared.policy.as_str();
    if let Some(why) = shared.refusal(&request) {
        return give(request, policy, 403, plain, why.to_owned());
    }
    if *request.method() != Method::Get {
        return give(request, policy, 405, plain, "There is nothing to do here but to look.\n".to_owned());
    }
    let url = request.url().to_owned();
    match url.split('?').next().unwrap_or_default() {
        "/" => give(request, policy, 200, "text/html; charset=utf-8", shared.page.clone()),
        "/history" => {
            give(request, policy, 200, "application/json", shared.history(&shared.joints(&url)).to_string());
        }
        "/events" => watch(request, &url, shared),
        _ => give(request, policy, 404, plain, "There is no such page.\n".to_owned()),
    }
}

/// Counts a watcher for as long as it lives.
struct Watching(Arc<Shared>);

impl Drop for Watching {
    fn drop(&mut self) {
        self.0.watchers.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Sends each new state until the watcher is gone, from a thread of its own.
fn watch(request: Request, url: &str, shared: &Arc<Shared>) {
    let before = shared.watchers.fetch_add(1, Ordering::Relaxed);
    let watching = Watching(shared.clone());
    if before >= WATCHERS {
        let plain = "text/plain; charset=utf-8";
        return give(request, &shared.policy, 503, plain, "Too many are watching already.\n".to_owned());
    }
    let joints = shared.joints(url);
    // Where there is no thread to be had, the request is dropped and the browser asks again.
    let _ = std::thread::Builder::new().name("live watcher".to_owned()).spawn(move || {
        // An error says that the watcher is gone, which is how watching ends.
        let _ = stream(request, &joints, &watching.0);
    });
}

fn stream(request: Request, joints: &[f64], shared: &Shared) -> io::Result<()> {
    let mut to = request.into_writer();
    write!(
        to,
        "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    )?;
    let mut number = 0;
    while let Some(shown) = shared.feed.after(number) {
        if shown.number == number {
            to.write_all(b": nothing new\n\n")?;
        } else {
            write!(to, "data: {}\n\n", shared.told(&shown, joints))?;
        }
        to.flush()?;
        number = shown.number;
    }
    to.write_all(b"event: end\ndata: {}\n\n")?;
    to.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_for_others_needs_a_token() {
        let feed = Arc::new(Feed::new(Default::default()));
        let refused = Server::start(([0, 0, 0, 0], 0).into(), None, feed.clone(), None, Vec::new());
        assert!(refused.is_err_and(|error| error.to_string().contains("token")));
        let server = Server::start(([0, 0, 0, 0], 0).into(), Some("secret".to_owned()), feed, None, Vec::new());
        assert!(server.is_ok_and(|server| server.url().ends_with("/?token=secret")));
    }

    #[test]
    fn queries_hosts_and_tokens_are_taken_apart() {
        assert_eq!(query("/events?token=abc&q=1,2", "q"), Some("1,2"));
        assert_eq!(query("/events", "q"), None);
        assert_eq!(
            ["localhost:8080", "[::1]:80", "[::1]", "127.0.0.1"].map(host),
            ["localhost", "[::1]", "[::1]", "127.0.0.1"]
        );
        assert!(same("abc", "abc") && !same("abc", "abd") && !same("ab", "abc"));
    }
}
