//! Temperatures for virtual boards from a recorded or simulated `temperatures.csv`.

use std::collections::HashMap;
use std::path::Path;

use crate::input::InputError;
use crate::robot::Robot;
use crate::run::TemperatureLog;

/// The temperatures of a run, by board and address.
#[derive(Debug, Clone, Default)]
pub struct Recorded {
    /// Times in seconds, ascending, and degrees Celsius.
    series: HashMap<(u32, u8), Vec<(f64, f64)>>,
}

impl Recorded {
    /// Reads `time_s,sensor,celsius` and finds each sensor's place in a robot; sensors without a place are left out.
    pub fn read(file: &Path, robot: &Robot) -> Result<Self, InputError> {
        let text = std::fs::read_to_string(file).map_err(|error| InputError::of_file(file, error.to_string()))?;
        let mut recorded = Self::default();
        for (index, line) in text.lines().enumerate() {
            let wrong = |expected: &str| InputError::at_line(file, index + 1, format!("expected {expected}"));
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            if index == 0 {
                if fields != ["time_s", "sensor", "celsius"] {
                    return Err(wrong("the columns time_s,sensor,celsius"));
                }
                continue;
            }
            let [time_s, name, celsius] = fields[..] else {
                return Err(wrong("three fields"));
            };
            let time_s: f64 = time_s.parse().map_err(|_| wrong("a time in seconds"))?;
            let celsius: f64 = celsius.parse().map_err(|_| wrong("a temperature in degrees Celsius"))?;
            let sensor = robot.sensors.iter().find(|sensor| sensor.name == name);
            if let Some((board, address)) = sensor.and_then(|sensor| sensor.board.zip(sensor.address)) {
                recorded.series.entry((board, address)).or_default().push((time_s, celsius));
            }
        }
        if recorded.series.is_empty() {
            return Err(InputError::of_file(file, "has no sensor that the robot has on a board"));
        }
        for series in recorded.series.values_mut() {
            series.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        Ok(recorded)
    }

    /// The readings of a log, by each sensor's place in a robot; sensors without a place are left out.
    pub fn of(log: &TemperatureLog, robot: &Robot) -> Self {
        let mut recorded = Self::default();
        for (name, series) in log.sensors.iter().zip(&log.series) {
            let sensor = robot.sensor(name).map(|place| &robot.sensors[place]);
            if let Some(place) = sensor.and_then(|sensor| sensor.board.zip(sensor.address)) {
                let readings = series.times_s().iter().copied().zip(series.celsius().iter().copied());
                recorded.series.insert(place, readings.collect());
            }
        }
        recorded
    }

    /// The temperature of a sensor at a time, interpolated; its first before, its last after; none if it has none.
    pub fn celsius(&self, board: u32, address: u8, seconds: f64) -> Option<f64> {
        let series = self.series.get(&(board, address))?;
        let after = series.partition_point(|(time_s, _)| *time_s < seconds);
        match (after.checked_sub(1).map(|before| series[before]), series.get(after)) {
            (Some((t0, c0)), Some(&(t1, c1))) => Some(c0 + (c1 - c0) * (seconds - t0) / (t1 - t0)),
            (Some((_, only)), None) | (None, Some(&(_, only))) => Some(only),
            (None, None) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_before_and_after_what_was_recorded() {
        let series = HashMap::from([((0, 0x48), vec![(10.0, 20.0), (20.0, 22.0)])]);
        let recorded = Recorded { series };
        let at = |seconds| recorded.celsius(0, 0x48, seconds);
        assert_eq!(
            [at(0.0), at(10.0), at(15.0), at(20.0), at(99.0)].map(Option::unwrap),
            [20.0, 20.0, 21.0, 22.0, 22.0]
        );
        assert_eq!(recorded.celsius(0, 0x49, 15.0), None);
    }
}
