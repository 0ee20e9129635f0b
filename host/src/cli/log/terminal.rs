//! The logger's live view: one row a sensor, the words that were said, and keys for runs and marks.

use std::io;
use std::time::Duration;

use ratatui::DefaultTerminal;
use ratatui::Frame;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Cell, Paragraph, Row, Table, TableState};
use thermokin_protocol::{Battery, Reading, Signal};

use crate::logger::civil;
use crate::logger::engine::{BoardEntry, Engine};
use crate::logger::gauge::Gauge;
use crate::logger::group::status_name;
use crate::logger::serve::{State, View, Wish};

/// The bars that a trend is drawn with, from low to high.
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
/// A history that spans less than this, in kelvin, is drawn flat: it is the sensor's noise.
const FLAT_K: f64 = 0.05;
/// A sensor that was not read for this long is shown as old, in seconds.
const OLD_S: f64 = 10.0;

/// The terminal, given back when this is dropped.
pub struct Terminal {
    terminal: DefaultTerminal,
    table: TableState,
    /// What is being typed: a run's name or a mark's text.
    typing: Option<(Typing, String)>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Typing {
    Run,
    Mark,
}

impl Terminal {
    /// Takes the terminal over.
    pub fn open() -> io::Result<Self> {
        Ok(Self { terminal: ratatui::try_init()?, table: TableState::default().with_selected(0), typing: None })
    }

    fn key(&mut self, key: KeyEvent, rows: usize, run: bool) -> Option<Wish> {
        if key.modifiers.contains(KeyModifiers::CONTROL) && key.code == KeyCode::Char('c') {
            return Some(Wish::Stop);
        }
        if let Some((typing, text)) = &mut self.typing {
            match key.code {
                KeyCode::Char(letter) => text.push(letter),
                KeyCode::Backspace => drop(text.pop()),
                KeyCode::Esc => self.typing = None,
                KeyCode::Enter => {
                    let verb = if *typing == Typing::Run { "run" } else { "mark" };
                    let wish = Wish::parse(&format!("{verb} {text}"));
                    self.typing = None;
                    return wish;
                }
                _ => {}
            }
            return None;
        }
        let selected = self.table.selected().unwrap_or(0);
        match key.code {
            KeyCode::Char('q') => return Some(Wish::Stop),
            KeyCode::Char('r') if run => return Some(Wish::StopRun),
            KeyCode::Char('r') => self.typing = Some((Typing::Run, String::new())),
            KeyCode::Char('m') => self.typing = Some((Typing::Mark, String::new())),
            KeyCode::Up => self.table.select(Some(selected.saturating_sub(1))),
            KeyCode::Down => self.table.select(Some((selected + 1).min(rows.saturating_sub(1)))),
            KeyCode::PageUp => self.table.select(Some(selected.saturating_sub(20))),
            KeyCode::PageDown => self.table.select(Some((selected + 20).min(rows.saturating_sub(1)))),
            _ => {}
        }
        None
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        ratatui::restore();
    }
}

impl View for Terminal {
    fn say(&mut self, _time_us: u64, _text: &str) {
        // The view shows what was said with everything else.
    }

    fn show(&mut self, engine: &Engine, state: &State, now_us: u64) -> Vec<Wish> {
        let rows = engine.boards().values().map(|board| board.gauges.len().max(1)).sum();
        let mut wishes = Vec::new();
        while event::poll(Duration::ZERO).unwrap_or(false) {
            if let Ok(Event::Key(key)) = event::read()
                && key.kind == KeyEventKind::Press
            {
                wishes.extend(self.key(key, rows, state.run.is_some()));
            }
        }
        let (table, typing) = (&mut self.table, &self.typing);
        // A frame that cannot be drawn is followed by the next.
        let _ = self.terminal.draw(|frame| draw(frame, engine, state, now_us, table, typing.as_ref()));
        wishes
    }
}

fn draw(
    frame: &mut Frame<'_>,
    engine: &Engine,
    state: &State,
    now_us: u64,
    table: &mut TableState,
    typing: Option<&(Typing, String)>,
) {
    let said = engine.watch().said().count().clamp(1, 8) as u16 + 2;
    let [head, body, words, foot] =
        Layout::vertical([Constraint::Length(2), Constraint::Min(5), Constraint::Length(said), Constraint::Length(1)])
            .areas(frame.area());
    frame.render_widget(heading(engine, state, now_us), head);
    sensors(frame, body, engine, now_us, table);
    let visible = usize::from(words.height.saturating_sub(2));
    let mut lines: Vec<Line<'_>> = engine
        .watch()
        .said()
        .rev()
        .take(visible)
        .map(|(at_us, text)| Line::from(format!("{} {text}", &civil::utc(at_us / 1_000_000)[11..])))
        .collect();
    lines.reverse();
    if lines.is_empty() {
        lines.push(Line::styled("nothing to warn of", Style::new().add_modifier(Modifier::DIM)));
    }
    frame.render_widget(Paragraph::new(lines).block(Block::bordered().title(" words ")), words);
    let foot_line = match typing {
        Some((Typing::Run, text)) => format!("name of the run: {text}▏   Enter starts it, Esc does not"),
        Some((Typing::Mark, text)) => format!("mark: {text}▏   Enter sets it, Esc does not"),
        None if state.run.is_some() => "q quit   r end the run   m mark a step   ↑↓ scroll".to_owned(),
        None => "q quit   r start a run   m mark a step   ↑↓ scroll".to_owned(),
    };
    frame.render_widget(Paragraph::new(foot_line).style(Style::new().add_modifier(Modifier::DIM)), foot);
}

fn heading(engine: &Engine, state: &State, now_us: u64) -> Paragraph<'static> {
    let tally = engine.tally();
    let heard = engine.boards().values().filter(|board| board.heard_us.is_some()).count();
    let run = match &state.run {
        Some((name, since_us)) => {
            let seconds = now_us.saturating_sub(*since_us) / 1_000_000;
            Span::styled(
                format!("run {name} {}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60),
                Style::new().fg(Color::Green).add_modifier(Modifier::BOLD),
            )
        }
        None => Span::styled("no run", Style::new().add_modifier(Modifier::DIM)),
    };
    let free = state.free.map_or(String::new(), |bytes| format!("   {:.1} GB free", bytes as f64 / 1e9));
    Paragraph::new(vec![
        Line::from(vec![
            Span::styled("thermokin log  ", Style::new().add_modifier(Modifier::BOLD)),
            run,
            Span::raw(format!("   {}   {}{free}", state.listen, state.store.display())),
        ]),
        Line::from(format!(
            "{heard} of {} boards heard   {} readings stored   {} records lost   {} datagrams refused",
            engine.boards().len(),
            tally.readings,
            tally.lost,
            tally.refused
        )),
    ])
}

fn sensors(frame: &mut Frame<'_>, area: Rect, engine: &Engine, now_us: u64, table: &mut TableState) {
    // Only what can be seen is made: there may be ten thousand boards.
    let height = usize::from(area.height.saturating_sub(3)).max(1);
    let selected = table.selected().unwrap_or(0);
    let first = selected.saturating_sub(height - 1);
    let all = engine
        .boards()
        .iter()
        .flat_map(|(number, board)| (0..board.gauges.len().max(1)).map(move |index| (*number, board, index)));
    let rows: Vec<Row<'_>> =
        all.skip(first).take(height).map(|(number, board, index)| row(number, board, index, now_us)).collect();
    let widths = [
        Constraint::Min(12),
        Constraint::Length(11),
        Constraint::Length(24),
        Constraint::Length(11),
        Constraint::Length(7),
        Constraint::Length(6),
        Constraint::Length(8),
        Constraint::Length(7),
        Constraint::Length(6),
        Constraint::Length(9),
    ];
    let header = Row::new(["sensor", "°C", "two minutes", "K/min", "age s", "board", "dBm", "mV", "lost", "clock ms"])
        .style(Style::new().add_modifier(Modifier::BOLD));
    let widget = Table::new(rows, widths)
        .header(header)
        .row_highlight_style(Style::new().add_modifier(Modifier::REVERSED))
        .block(Block::bordered().title(" sensors "));
    let mut shown = TableState::default().with_selected(Some(selected - first));
    frame.render_stateful_widget(widget, area, &mut shown);
}

fn row(number: u32, board: &BoardEntry, index: usize, now_us: u64) -> Row<'static> {
    let quiet = Style::new().add_modifier(Modifier::DIM);
    let Some((gauge, label)) = board.gauges.get(index).zip(board.labels().get(index)) else {
        return Row::new([
            "not heard yet".to_owned(),
            String::new(),
            String::new(),
            String::new(),
            String::new(),
            number.to_string(),
        ])
        .style(quiet);
    };
    let age_s = gauge.value().map(|(at_us, _)| now_us.saturating_sub(at_us) as f64 / 1e6);
    let value = match (gauge.reading(), gauge.value()) {
        (Some(reading @ (Reading::Absent | Reading::BusError)), _) => status_name(reading).to_owned(),
        (Some(Reading::OutOfRange(_)), Some((_, celsius))) => format!("{celsius:.3} !"),
        (_, Some((_, celsius))) => format!("{celsius:.3}"),
        (_, None) => String::new(),
    };
    let bad = matches!(gauge.reading(), Some(Reading::Absent | Reading::BusError | Reading::OutOfRange(_)));
    let style = match (bad, age_s) {
        (true, _) => Style::new().fg(Color::Red),
        (false, Some(age_s)) if age_s < OLD_S => Style::new(),
        _ => Style::new().fg(Color::Yellow),
    };
    let health = board.report.map(|report| report.health);
    let signal = match health.map(|health| health.signal) {
        Some(Signal::Dbm(dbm)) => dbm.to_string(),
        _ => "–".to_owned(),
    };
    let battery = match health.map(|health| health.battery) {
        Some(Battery::Millivolts(millivolts)) => millivolts.to_string(),
        _ => "–".to_owned(),
    };
    let clock = board.fit().and_then(|fit| fit.offset_uncertainty_us).map(|us| format!("±{:.1}", us / 1e3));
    Row::new([
        Cell::from(label.name.clone()),
        Cell::from(value),
        Cell::from(bars(gauge)),
        Cell::from(gauge.trend_k_per_min().map_or(String::new(), |trend| format!("{trend:+.2}"))),
        Cell::from(age_s.map_or(String::new(), |age_s| format!("{age_s:.0}"))),
        Cell::from(number.to_string()),
        Cell::from(signal),
        Cell::from(battery),
        Cell::from(board.lost.to_string()),
        Cell::from(clock.unwrap_or_else(|| "–".to_owned())),
    ])
    .style(style)
}

fn bars(gauge: &Gauge) -> String {
    let (low, high) =
        gauge.history().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    let span = (high - low).max(FLAT_K);
    gauge.history().map(|celsius| BARS[(((celsius - low) / span * 7.0).round() as usize).min(7)]).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, HashMap};
    use std::net::SocketAddr;

    use ratatui::backend::TestBackend;
    use thermokin_protocol::{
        BoardCounters, BoardLink, Firmware, Identity, Key, MAX_DATAGRAM, ResetReason, Sensor, SensorKind, Settings,
    };

    use super::*;
    use crate::logger::registry::{Board, Registry};

    const START_US: u64 = 1_795_000_000_000_000;

    fn place(board: u32, sensors: Vec<u8>) -> Board {
        let key = Key::from_bytes([board as u8; 32]);
        Board { board, robot: "arm".into(), link: 0, sensors, key, first_boot: 1 }
    }

    /// A minute of a board with two sensors, of which one warms by 1/256 K a second and one is absent; a second board is
    /// not heard.
    fn engine() -> Engine {
        let registry = Registry {
            settings: Settings { revision: 1, ..Settings::default() },
            boards: vec![place(3, vec![0x48, 0x49]), place(4, vec![0x48])],
        };
        let names = HashMap::from([((3, 0x48), "L0S1".to_owned()), ((3, 0x49), "L0S2".to_owned())]);
        let mut engine = Engine::new((START_US / 1_000_000) as u32, &registry, names, BTreeMap::new());
        let identity =
            Identity { firmware: Firmware { major: 0, minor: 1, patch: 0 }, reset: ResetReason::PowerOn, capacity: 0 };
        let sensors = [0x48, 0x49].map(|address| Sensor { address, kind: SensorKind::Max30205 });
        let key = registry.boards[0].key.clone();
        let mut board: BoardLink<256> = BoardLink::new(3, key, 1, identity, &sensors, registry.settings, 0);
        board.set_health(Battery::Millivolts(3987), Signal::Dbm(-61), BoardCounters::default());
        let address = SocketAddr::from(([127, 0, 0, 1], 9));
        let mut buffer = [0; MAX_DATAGRAM];
        for second in 1..=60 {
            let (board_us, now_us) = (second * 1_000_000, START_US + second * 1_000_000);
            board.record(board_us, &[Reading::Ok(5120 + second as i16), Reading::Absent]);
            while let Some(length) = board.poll(board_us, &mut buffer) {
                assert_eq!(engine.on_datagram(address, &mut buffer[..length], now_us), None);
            }
            engine.close_group(now_us).expect("something came");
            engine.committed(now_us);
            engine.answers(
                || now_us,
                |_, answer| {
                    board.receive(board_us + 1000, &mut answer.to_vec()).expect("it is authentic");
                },
            );
        }
        engine
    }

    #[test]
    fn a_row_a_sensor_with_all_that_matters() {
        let engine = engine();
        let state = State {
            listen: SocketAddr::from(([127, 0, 0, 1], 4840)),
            store: "log".into(),
            run: Some(("warm-up".to_owned(), START_US)),
            free: Some(5_000_000_000),
        };
        let mut terminal = ratatui::Terminal::new(TestBackend::new(120, 14)).expect("it has a size");
        let now_us = START_US + 62_000_000;
        terminal
            .draw(|frame| draw(frame, &engine, &state, now_us, &mut TableState::default(), None))
            .expect("it is drawn");
        let screen = terminal.backend().buffer();
        let lines: Vec<String> =
            screen.content().chunks(120).map(|line| line.iter().map(|cell| cell.symbol()).collect()).collect();
        let words = |line: usize| -> Vec<&str> { lines[line].split_whitespace().collect() };
        assert!(lines[0].contains("run warm-up 0:01:02") && lines[0].contains("5.0 GB free"), "{lines:#?}");
        // A reading that says why there is no value is one, too.
        assert!(lines[1].starts_with("1 of 2 boards heard   120 readings stored   0 records lost"), "{lines:#?}");
        // Name, value, bars, trend, age, board, signal, battery, losses, clock.
        let warming = words(4);
        assert_eq!(warming[..2], ["│L0S1", "20.234"], "{lines:#?}");
        assert!(warming[2].starts_with('▁') && warming[2].ends_with('█'), "{lines:#?}");
        assert_eq!(warming[3..9], ["+0.23", "2", "3", "-61", "3987", "0"], "{lines:#?}");
        assert!(warming[9].starts_with('±'), "{lines:#?}");
        assert_eq!(words(5)[..2], ["│L0S2", "absent"], "{lines:#?}");
        assert_eq!(words(6)[..4], ["│not", "heard", "yet", "4"], "{lines:#?}");
        let said = lines.iter().find(|line| line.contains("gives no reading")).expect("it is told");
        assert!(said.contains("sensor L0S2 gives no reading (absent), board 3 address 0x49"), "{lines:#?}");
    }
}
