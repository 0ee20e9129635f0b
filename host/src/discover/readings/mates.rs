//! What the other sensors tell of one: its mates on the link and near it, and what they read a while ago.

use super::explained::{Explained, Response};
use super::grid::Grid;

/// Lags at which mates count as well, s: heat takes its time between two sensors.
const LAGS_S: [f64; 2] = [120.0, 600.0];

/// The lag of the air, s.
const AIR_LAG_S: f64 = 300.0;

/// How many sensors of neighbouring links count as mates.
const NEAR: usize = 2;

/// All columns that mates may give, over the known rows.
pub(super) struct Mates<'a> {
    grid: &'a Grid,
    /// Each sensor as read, then at each lag.
    columns: Vec<[Vec<f64>; 1 + LAGS_S.len()]>,
    air: Option<[Vec<f64>; 2]>,
}

impl<'a> Mates<'a> {
    /// The columns of a grid.
    pub fn new(grid: &'a Grid) -> Self {
        let columns = grid
            .sensors
            .iter()
            .map(|sensor| {
                let lagged = |tau| grid.take(&grid.lagged(&sensor.celsius, tau));
                [grid.take(&sensor.celsius), lagged(LAGS_S[0]), lagged(LAGS_S[1])]
            })
            .collect();
        let air = grid.air.as_ref().map(|air| [grid.take(air), grid.take(&grid.lagged(air, AIR_LAG_S))]);
        Self { grid, columns, air }
    }

    /// What a sensor read, over the known rows.
    pub fn read(&self, sensor: usize) -> &[f64] {
        &self.columns[sensor][0]
    }

    /// The air, over the known rows.
    pub fn air(&self) -> Option<&[f64]> {
        self.air.as_ref().map(|[now, _]| now.as_slice())
    }

    /// The other sensors of its link.
    pub fn of_link(&self, sensor: usize) -> Vec<usize> {
        let sensors = &self.grid.sensors;
        (0..sensors.len()).filter(|&other| other != sensor && sensors[other].link == sensors[sensor].link).collect()
    }

    /// The other sensors of its link and the likest of the nearest links.
    pub fn near(&self, sensor: usize) -> Vec<usize> {
        let sensors = &self.grid.sensors;
        let far = |other: usize| sensors[other].link.abs_diff(sensors[sensor].link);
        let nearest = (0..sensors.len()).map(far).filter(|far| *far > 0).min();
        let mut others: Vec<(f64, usize)> = (0..sensors.len())
            .filter(|&other| Some(far(other)) == nearest)
            .map(|other| (self.unlikeness(sensor, other), other))
            .collect();
        others.sort_by(|left, right| left.0.total_cmp(&right.0));
        let mut mates = self.of_link(sensor);
        mates.extend(others.into_iter().take(NEAR).map(|(_, other)| other));
        mates
    }

    /// Variance of the difference of two sensors.
    fn unlikeness(&self, one: usize, other: usize) -> f64 {
        let (one, other) = (self.read(one), self.read(other));
        let count = one.len() as f64;
        let mean = one.iter().zip(other).map(|(a, b)| a - b).sum::<f64>() / count;
        one.iter().zip(other).map(|(a, b)| (a - b - mean).powi(2)).sum::<f64>() / count
    }

    /// What these sensors explain freely, with the air and with what both were a while ago.
    pub fn free(&self, mates: &[usize]) -> Explained {
        let air = self.air.iter().map(|[_, lagged]| lagged.clone());
        let read = mates.iter().flat_map(|&mate| self.columns[mate].iter().cloned());
        Explained::by(self.grid.rows.len(), air.chain(read))
    }

    /// A sensor above the mean of its mates, given what they explain as interpolation between them does: by weights that
    /// sum to one; and that mean.
    pub fn interpolated(&self, sensor: usize, mates: &[usize]) -> (Response, Vec<f64>) {
        let rows = self.grid.rows.len();
        let mean: Vec<f64> = (0..rows)
            .map(|row| mates.iter().map(|&mate| self.read(mate)[row]).sum::<f64>() / mates.len().max(1) as f64)
            .collect();
        let above =
            |column: &[f64]| -> Vec<f64> { column.iter().zip(&mean).map(|(value, mean)| value - mean).collect() };
        let columns = mates.iter().flat_map(|&mate| self.columns[mate].iter().map(|column| above(column)));
        (Response::new(Explained::by(rows, columns), &above(self.read(sensor))), mean)
    }
}
