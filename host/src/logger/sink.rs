//! The seam for where readings go: a sink takes a group of what was decoded and returns when that is durable.
//!
//! The store of MCAP files is the first; what publishes to a fleet (NATS JetStream, Parquet on an object store) is another.
//! Acknowledgements to the boards follow a sink's return, never anything else.

use std::io;
use std::path::PathBuf;

use super::group::Group;

/// Why a group is not durable.
#[derive(Debug, thiserror::Error)]
#[error("{}: {error}", path.display())]
pub struct SinkError {
    /// What could not be written.
    pub path: PathBuf,
    /// Why.
    pub error: io::Error,
}

/// Takes what was decoded.
pub trait Sink: Send {
    /// Makes a group durable. On an error nothing of the group may count as stored; the boards send it again.
    fn take(&mut self, group: &Group) -> Result<(), SinkError>;

    /// Ends what is open, in good order.
    fn finish(&mut self) -> Result<(), SinkError>;
}
