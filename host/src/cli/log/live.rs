//! The live page's options, and its place beside the logger's other view.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;

use super::super::Failure;
use crate::input::InputError;
use crate::live::{Feed, Predictor, Server};
use crate::logger::engine::Engine;
use crate::logger::registry::{hex, new_key};
use crate::logger::serve::{State, View, Wish};
use crate::model::Model;
use crate::robot::Robot;

/// What the live page is to be.
#[derive(Debug, Args)]
pub struct LiveArguments {
    /// Serve a live page at this address; beyond this machine, its address carries a token
    #[arg(long, value_name = "ADDRESS:PORT")]
    http: Option<SocketAddr>,
    /// The token of the live page [default: a new one where others can reach the address]
    #[arg(long, value_name = "TOKEN", requires = "http", value_parser = token)]
    http_token: Option<String>,
    /// Predict the drift of the tool by this model, on the live page
    #[arg(long, value_name = "MODEL", requires = "http")]
    model: Option<PathBuf>,
    /// Where to predict it: joints in degrees (millimetres where they slide), as in 0,-30,90,0,45,0 [default: all 0]
    #[arg(long, value_name = "JOINTS", requires = "model", value_delimiter = ',', allow_hyphen_values = true)]
    posture: Vec<f64>,
}

/// Tokens stand in addresses as they are.
fn token(text: &str) -> Result<String, String> {
    let plain = text.len() >= 16 && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
    if plain { Ok(text.to_owned()) } else { Err("expected 16 letters, digits, - and _ or more".to_owned()) }
}

/// The page while it is served.
pub struct Page {
    feed: Arc<Feed>,
    server: Server,
}

/// Two views of one logger.
struct Beside {
    first: Box<dyn View>,
    feed: Arc<Feed>,
}

impl Page {
    /// Serves the page, where one is asked for.
    ///
    /// # Errors
    /// A model or a robot that cannot be read, a posture that does not fit, an address that cannot be listened on.
    pub fn start(arguments: &LiveArguments, robot: Option<&Path>) -> Result<Option<Page>, Failure> {
        let Some(address) = arguments.http else { return Ok(None) };
        let mut links = HashMap::new();
        if let Some(path) = robot {
            links.extend(Robot::read(path)?.sensors.into_iter().map(|sensor| (sensor.name, sensor.link)));
        }
        let model = arguments.model.as_deref().map(Model::read).transpose()?;
        let predictor = model.as_ref().map(Predictor::new);
        let posture = posture(arguments, predictor.as_ref())?;
        let token = match (&arguments.http_token, address.ip().is_loopback()) {
            (Some(token), _) => Some(token.clone()),
            (None, true) => None,
            (None, false) => Some(hex(&new_key().map_err(|error| Failure::Work(format!("a token: {error}")))?)),
        };
        let feed = Arc::new(Feed::new(links));
        let server = Server::start(address, token, feed.clone(), predictor, posture)
            .map_err(|error| Failure::Work(error.to_string()))?;
        Ok(Some(Page { feed, server }))
    }

    /// A view that shows what another shows, and on the page.
    pub fn beside(&self, mut first: Box<dyn View>) -> Box<dyn View> {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        let now_us = now.map_or(0, |since| since.as_micros() as u64);
        first.say(now_us, &format!("live page: {}", self.server.url()));
        Box::new(Beside { first, feed: self.feed.clone() })
    }
}

impl View for Beside {
    fn say(&mut self, time_us: u64, text: &str) {
        self.first.say(time_us, text);
    }

    fn show(&mut self, engine: &Engine, state: &State, now_us: u64) -> Vec<Wish> {
        self.feed.put(engine, state, now_us);
        self.first.show(engine, state, now_us)
    }
}

/// The posture in radians and metres.
fn posture(arguments: &LiveArguments, predictor: Option<&Predictor>) -> Result<Vec<f64>, Failure> {
    let (Some(predictor), Some(file)) = (predictor, &arguments.model) else { return Ok(Vec::new()) };
    let turning = predictor.turning();
    if arguments.posture.is_empty() {
        return Ok(vec![0.0; turning.len()]);
    }
    if arguments.posture.len() != turning.len() || arguments.posture.iter().any(|joint| !joint.is_finite()) {
        let message = format!("--posture: expected {} joints, as the model's arm has", turning.len());
        return Err(InputError::of_file(file, message).into());
    }
    let joints = arguments.posture.iter().zip(&turning);
    Ok(joints.map(|(joint, turns)| if *turns { joint.to_radians() } else { joint / 1e3 }).collect())
}
