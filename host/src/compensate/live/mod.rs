//! Corrections for a robot that moves: present temperatures followed, requests answered over a local socket.
//!
//! `follower` is what is believed of the temperatures, without files, sockets and clocks; `source` reads them where the
//! logger leaves them; `request` is what is asked and answered, a line of JSON each; `server` gives it sockets and
//! threads.

mod follower;
mod request;
mod server;
mod source;

pub use follower::{Follower, Footing, Reading};
pub use request::{Answerer, LONGEST_REQUEST, Moment};
pub use server::{Listening, Server, ServerError};
pub use source::{Source, SourceError};
