//! The channels of a log file: their names, their schemas, and what their messages look like.

/// A channel of a log file. Messages are JSON, but for the exact datagrams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Topic {
    /// One message a record of a board, `/board/N/readings`.
    Readings(u32),
    /// One message a report of a board, `/board/N/status`: health, counters, and what it says of the clock.
    Status(u32),
    /// Records that will never come, `/gaps`.
    Gaps,
    /// Runs and marks, `/marks`.
    Marks,
    /// Warnings that were told, `/warnings`.
    Warnings,
    /// What the host must remember of each board, `/delivery`.
    Delivery,
    /// Files that were given up after an error, `/files`.
    Files,
    /// Every datagram that was accepted, as it came, sealed, `/datagrams`.
    Datagrams,
}

impl Topic {
    /// The name that other tools show.
    pub fn name(self) -> String {
        match self {
            Topic::Readings(board) => format!("/board/{board}/readings"),
            Topic::Status(board) => format!("/board/{board}/status"),
            Topic::Gaps => "/gaps".to_owned(),
            Topic::Marks => "/marks".to_owned(),
            Topic::Warnings => "/warnings".to_owned(),
            Topic::Delivery => "/delivery".to_owned(),
            Topic::Files => "/files".to_owned(),
            Topic::Datagrams => "/datagrams".to_owned(),
        }
    }

    /// The topic of a name that [`Topic::name`] gave.
    pub fn of_name(name: &str) -> Option<Self> {
        Some(match name {
            "/gaps" => Topic::Gaps,
            "/marks" => Topic::Marks,
            "/warnings" => Topic::Warnings,
            "/delivery" => Topic::Delivery,
            "/files" => Topic::Files,
            "/datagrams" => Topic::Datagrams,
            _ => {
                let (board, kind) = name.strip_prefix("/board/")?.split_once('/')?;
                let board = board.parse().ok()?;
                match kind {
                    "readings" => Topic::Readings(board),
                    "status" => Topic::Status(board),
                    _ => return None,
                }
            }
        })
    }

    /// How its messages are encoded.
    pub fn encoding(self) -> &'static str {
        match self {
            Topic::Datagrams => "thermokin-datagram",
            _ => "json",
        }
    }

    /// Its schema: id, name and JSON schema; id 0 is none.
    pub(super) fn schema(self) -> (u16, &'static str, &'static str) {
        match self {
            Topic::Readings(_) => (1, "thermokin.Readings", READINGS),
            Topic::Status(_) => (2, "thermokin.Status", STATUS),
            Topic::Gaps => (3, "thermokin.Gap", GAP),
            Topic::Marks => (4, "thermokin.Mark", MARK),
            Topic::Warnings => (5, "thermokin.Warning", WARNING),
            Topic::Delivery => (6, "thermokin.Delivery", DELIVERY),
            Topic::Files => (7, "thermokin.File", FILE),
            Topic::Datagrams => (0, "", ""),
        }
    }
}

const READINGS: &str = r#"{"type":"object","title":"thermokin.Readings","properties":{
"time_s":{"type":"number","description":"when the sensors were read, on the host's clock, seconds since 1970, as known on arrival"},
"uncertainty_s":{"type":["number","null"],"description":"how far off time_s can be; null while the clock has not settled"},
"board":{"type":"integer"},"store":{"type":"integer"},"boot":{"type":"integer"},"sequence":{"type":"integer"},
"board_us":{"type":"integer","description":"when the sensors were read, on the board's clock of that boot"},
"celsius":{"type":"object","description":"by sensor; absent where there is no reading"},
"counts":{"type":"object","description":"by sensor, raw"},
"status":{"type":"object","description":"by sensor: ok, absent, bus_error or out_of_range"}}}"#;
const STATUS: &str = r#"{"type":"object","title":"thermokin.Status","properties":{
"board":{"type":"integer"},"boot":{"type":"integer"},"datagram":{"type":"integer"},"arrived_us":{"type":"integer"},"sent_us":{"type":"integer"},
"echo":{"type":["object","null"],"properties":{"host_us":{"type":"integer"},"received_us":{"type":"integer"}}},
"battery_mv":{"type":["integer","null"]},"signal_dbm":{"type":["integer","null"]},
"reads_failed":{"type":"integer"},"bus_recoveries":{"type":"integer"},"records_dropped":{"type":"integer"},"resends":{"type":"integer"},"datagrams_refused":{"type":"integer"},
"settings_revision":{"type":"integer"},
"clock":{"type":["object","null"],"properties":{"reference_us":{"type":"integer"},"offset_us":{"type":"number"},"drift":{"type":"number"},"uncertainty_us":{"type":["number","null"]}}},
"identity":{"type":["object","null"]}}}"#;
const GAP: &str = r#"{"type":"object","title":"thermokin.Gap","properties":{
"board":{"type":"integer"},"store":{"type":"integer"},
"stores_until":{"type":"integer","description":"one past the last store that this says the same of"},"from":{"type":"integer"},
"until":{"type":["integer","null"],"description":"one past the last; null where nobody knows how many"},
"reason":{"type":"string","description":"not_held: thinned out by a full store, or taken by another log; store_ended: lost with its store; unheard: the store, if a boot of this number began one, was never heard of"}}}"#;
const MARK: &str = r#"{"type":"object","title":"thermokin.Mark","properties":{
"time_s":{"type":"number"},"kind":{"type":"string","description":"run_start, run_stop or mark"},"name":{"type":"string"}}}"#;
const WARNING: &str = r#"{"type":"object","title":"thermokin.Warning","properties":{"time_s":{"type":"number"},"text":{"type":"string"}}}"#;
const DELIVERY: &str = r#"{"type":"object","title":"thermokin.Delivery","properties":{
"board":{"type":"integer"},"boot":{"type":"integer"},"next":{"type":"integer"},"heard":{"type":"string"},
"store_boot":{"type":"integer"},"store":{"type":["integer","null"]},"below":{"type":"integer"},"segments":{"type":"array"}}}"#;
const FILE: &str = r#"{"type":"object","title":"thermokin.File","properties":{"file":{"type":"string"},
"durable":{"type":"integer","description":"the file was given up after an error: nothing from this byte on counts"}}}"#;
