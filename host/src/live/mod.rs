//! The live page of the logger: what it hears, in a browser, while it happens, and what a model makes of it.
//!
//! The logger's thread only puts its state here, four times a second (`feed`); browsers are served by threads of their own
//! (`server`), which never make the logger wait. What is kept for those who come later is bounded however long the logger
//! runs (`history`); `drift` is the model's word on it.

mod drift;
mod feed;
mod history;
mod server;

pub use drift::{Drift, Predictor};
pub use feed::{Feed, Newest, Shown};
pub use history::{History, Row};
pub use server::{LiveError, Server};
