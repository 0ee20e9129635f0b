//! Sockets and threads of the live mode: one thread a connection, one that follows the temperatures.
//!
//! Requests of a connection are answered in their order. What is in flight waits in the kernel's buffers and nowhere else: a
//! client that does not read its answers blocks its own connection, and after a while loses it.

use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::super::arm::{Arm, Conditions};
use super::super::correction::{Corrector, Guard};
use super::follower::Follower;
use super::request::{Answerer, LONGEST_REQUEST, Moment};
use super::source::Source;
use crate::model::{Level, Model};

/// Connections at a time; a robot needs one.
const MOST_CONNECTIONS: usize = 64;

/// How often a thread that waits looks whether it is to end.
const LOOK: Duration = Duration::from_millis(100);

/// A client that takes no answer for this long is given up.
const PATIENCE: Duration = Duration::from_secs(5);

/// How often temperatures are looked at.
const PERIOD: Duration = Duration::from_millis(250);

/// Why the live mode cannot begin.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address is not this machine's own.
    #[error(
        "{0}: expected an address of this machine alone, such as 127.0.0.1:7117: whoever reaches it moves the robot"
    )]
    NotLocal(SocketAddr),
    /// The address cannot be listened at.
    #[error("{address}: cannot be listened at: {error}")]
    Listen {
        /// The address or path.
        address: String,
        /// Why.
        error: io::Error,
    },
}

/// Where to listen.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listening {
    /// A TCP port of this machine.
    Tcp(SocketAddr),
    /// A Unix socket at a path.
    #[cfg(unix)]
    Unix(PathBuf),
}

/// What all threads share.
struct Shared {
    moment: RwLock<Arc<Moment>>,
    guard: Arc<Mutex<Guard>>,
    corrector: Corrector,
    connections: AtomicUsize,
    stop: Arc<AtomicBool>,
    began: Instant,
}

impl Shared {
    fn now_s(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    fn moment(&self) -> Arc<Moment> {
        Arc::clone(&self.moment.read().unwrap_or_else(PoisonError::into_inner))
    }
}

/// A running live mode.
pub struct Server {
    shared: Arc<Shared>,
    address: Option<SocketAddr>,
    path: Option<PathBuf>,
    threads: Vec<JoinHandle<()>>,
}

impl Server {
    /// Begins to follow the temperatures and to listen; `say` is called with every change of what corrections rest on.
    ///
    /// # Errors
    /// An address that is not local or cannot be listened at.
    pub fn begin(
        model: &Model,
        level: Level,
        source: Option<Source>,
        listening: &Listening,
        stop: Arc<AtomicBool>,
        say: impl Fn(&str) + Send + 'static,
    ) -> Result<Self, ServerError> {
        let arm = Arm::new(model, level);
        let follower = Follower::new(model.temperatures.clone(), arm.needed_sensors(), model.correction_bounds);
        let corrector = Corrector::new(model);
        let began = Instant::now();
        let mut thermal = Thermal { arm, follower, source, trouble: None, said: Vec::new() };
        let first = thermal.moment(began.elapsed().as_secs_f64(), true, &say);
        let shared = Arc::new(Shared {
            moment: RwLock::new(Arc::new(first)),
            guard: Arc::new(Mutex::new(corrector.guard())),
            corrector,
            connections: AtomicUsize::new(0),
            stop,
            began,
        });
        let mut server = Self { shared: Arc::clone(&shared), address: None, path: None, threads: Vec::new() };
        match listening {
            Listening::Tcp(address) => {
                if !address.ip().is_loopback() {
                    return Err(ServerError::NotLocal(*address));
                }
                let failed = |error| ServerError::Listen { address: address.to_string(), error };
                let listener = TcpListener::bind(address).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                server.address = Some(listener.local_addr().map_err(failed)?);
                let shared = Arc::clone(&shared);
                server.threads.push(thread::spawn(move || {
                    accept(&shared, || listener.accept().map(|(stream, _)| stream), TcpStream::try_clone);
                }));
            }
            #[cfg(unix)]
            Listening::Unix(path) => {
                let failed = |error| ServerError::Listen { address: path.display().to_string(), error };
                let listener = unix_listener(path).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                server.path = Some(path.clone());
                let shared = Arc::clone(&shared);
                server.threads.push(thread::spawn(move || {
                    let clone = std::os::unix::net::UnixStream::try_clone;
                    accept(&shared, || listener.accept().map(|(stream, _)| stream), clone);
                }));
            }
        }
        server.threads.push(thread::spawn(move || {
            while !shared.stop.load(Ordering::Relaxed) {
                thread::sleep(PERIOD);
                let moment = Arc::new(thermal.moment(shared.now_s(), false, &say));
                *shared.moment.write().unwrap_or_else(PoisonError::into_inner) = moment;
            }
        }));
        Ok(server)
    }

    /// The TCP address that it listens at.
    pub fn address(&self) -> Option<SocketAddr> {
        self.address
    }

    /// Waits until it is told to stop, and ends its threads.
    pub fn wait(self) {
        for thread in self.threads {
            // A thread that panicked has nothing left to end.
            let _ = thread.join();
        }
        if let Some(path) = &self.path {
            // The socket's file is of no use without the server; if it is gone already, so much the better.
            let _ = std::fs::remove_file(path);
        }
    }

    /// Tells it to stop.
    pub fn stop(&self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }
}

/// A socket's file that nobody listens at any more is replaced; one that somebody does is not.
#[cfg(unix)]
fn unix_listener(path: &Path) -> io::Result<std::os::unix::net::UnixListener> {
    use std::os::unix::net::{UnixListener, UnixStream};
    match UnixListener::bind(path) {
        Err(error) if error.kind() == io::ErrorKind::AddrInUse && UnixStream::connect(path).is_err() => {
            use std::os::unix::fs::FileTypeExt;
            if !std::fs::symlink_metadata(path)?.file_type().is_socket() {
                return Err(error);
            }
            std::fs::remove_file(path)?;
            UnixListener::bind(path)
        }
        outcome => outcome,
    }
}

/// The thread that follows the temperatures.
struct Thermal {
    arm: Arm,
    follower: Follower,
    source: Option<Source>,
    trouble: Option<String>,
    said: Vec<String>,
}

impl Thermal {
    fn moment(&mut self, now_s: f64, first: bool, say: &impl Fn(&str)) -> Moment {
        let readings = self.source.as_mut().map(|source| source.poll(self.arm.model()));
        self.trouble = match readings {
            Some(Ok(readings)) => {
                self.follower.take(&readings, now_s);
                None
            }
            Some(Err(error)) => Some(error.to_string()),
            None => None,
        };
        self.follower.step(now_s, first);
        let celsius = self.follower.celsius();
        let conditions = Conditions {
            history: self.follower.history().to_vec(),
            time_s: now_s,
            celsius: celsius.clone(),
            ..Conditions::default()
        };
        let footing = self.follower.footing().clone();
        self.report(&footing, say);
        let names = self.arm.model().temperatures.iter().map(|reference| reference.sensor.clone());
        Moment {
            present: self.arm.under(&conditions),
            celsius: names.zip(celsius).filter_map(|(name, celsius)| Some((name, celsius?))).collect(),
            footing,
        }
    }

    /// Says what changed since it was last said: not how long a silence lasts, which changes all the time.
    fn report(&mut self, footing: &super::Footing, say: &impl Fn(&str)) {
        let mut words = vec![footing.name().to_owned()];
        words.extend(footing.why().iter().map(|why| why.split(" for ").next().unwrap_or(why).to_owned()));
        words.extend(self.trouble.clone());
        if words != self.said {
            let why: Vec<String> = footing.why().iter().cloned().chain(self.trouble.clone()).collect();
            let because = if why.is_empty() { String::new() } else { format!(": {}", why.join("; ")) };
            say(&format!("temperatures: {}{because}", footing.name()));
            self.said = words;
        }
    }
}

/// What both kinds of stream can do.
trait Stream: Read + Write + Send + 'static {
    fn prepare(&self) -> io::Result<()>;
}

impl Stream for TcpStream {
    fn prepare(&self) -> io::Result<()> {
        self.set_nonblocking(false)?;
        // An answer is a line and waited for: it must not lie until there are more.
        self.set_nodelay(true)?;
        self.set_read_timeout(Some(LOOK))?;
        self.set_write_timeout(Some(PATIENCE))
    }
}

#[cfg(unix)]
impl Stream for std::os::unix::net::UnixStream {
    fn prepare(&self) -> io::Result<()> {
        self.set_nonblocking(false)?;
        self.set_read_timeout(Some(LOOK))?;
        self.set_write_timeout(Some(PATIENCE))
    }
}

fn accept<S: Stream>(
    shared: &Arc<Shared>,
    mut next: impl FnMut() -> io::Result<S>,
    clone: impl Fn(&S) -> io::Result<S>,
) {
    while !shared.stop.load(Ordering::Relaxed) {
        let Ok(mut stream) = next() else {
            // Nobody is there, or nobody can be taken in at the moment: looked at again soon.
            thread::sleep(Duration::from_millis(5));
            continue;
        };
        if shared.connections.fetch_add(1, Ordering::Relaxed) >= MOST_CONNECTIONS {
            // A client that is gone before it hears this needs no word.
            let _ = stream.write_all(b"{\"id\":null,\"ok\":false,\"error\":\"too many connections\"}\n");
            shared.connections.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let prepared = stream.prepare().and_then(|()| clone(&stream));
        let shared = Arc::clone(shared);
        thread::spawn(move || {
            if let Ok(writer) = prepared {
                // A connection that fails is over; the client sees that and nobody else needs to.
                let _ = serve(&shared, stream, writer);
            }
            shared.connections.fetch_sub(1, Ordering::Relaxed);
        });
    }
}

/// Answers one connection until it ends.
fn serve(shared: &Shared, reader: impl Read, writer: impl Write) -> io::Result<()> {
    let mut reader = BufReader::new(reader);
    let mut writer = BufWriter::new(writer);
    let mut answerer = Answerer::new(shared.moment(), shared.corrector.clone(), Arc::clone(&shared.guard));
    let mut line = Vec::new();
    while !shared.stop.load(Ordering::Relaxed) {
        let room = (LONGEST_REQUEST + 1).saturating_sub(line.len()) as u64;
        match reader.by_ref().take(room).read_until(b'\n', &mut line) {
            Ok(_) if line.last() == Some(&b'\n') => {}
            Ok(_) if line.len() > LONGEST_REQUEST => {
                writeln!(
                    writer,
                    "{{\"id\":null,\"ok\":false,\"error\":\"a request longer than {LONGEST_REQUEST} bytes: closed\"}}"
                )?;
                return writer.flush();
            }
            // The end of the stream: half a request is none.
            Ok(_) => return Ok(()),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => continue,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        }
        if !line.trim_ascii().is_empty() {
            answerer.renew(&shared.moment());
            let answer = answerer.answer(line.trim_ascii(), shared.now_s());
            writer.write_all(answer.as_bytes())?;
            writer.write_all(b"\n")?;
        }
        line.clear();
        // Answers leave together where requests came together.
        if reader.buffer().is_empty() {
            writer.flush()?;
        }
    }
    Ok(())
}
