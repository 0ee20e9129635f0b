//! Heat in the arm: a network of nodes with heat capacities, conductances between them and to boundaries (air, floor).
//!
//! `C dT/dt = P + G_b (T_b - T) - K T`, where `C` is the diagonal of capacities (J/K), `K` the conductances between nodes
//! (W/K), `G_b` those to boundaries at temperatures `T_b`, and `P` the sources (W). Within a step of the schedule all
//! coefficients stay. A time step is the implicit midpoint rule, `(C/h + A/2) δ = P + G_b T_b - A T` with `A = K + G_b`:
//! of second order, stable for every step length, and it keeps the balance of energy exactly: what the nodes store is
//! what sources and boundaries gave at the midpoint.

/// A node's link to something whose temperature is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Boundary {
    /// The node.
    pub node: usize,
    /// W/K.
    pub conductance: f64,
    /// °C.
    pub celsius: f64,
}

/// The nodes and what conducts between them.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Network {
    /// J/K of each node.
    pub capacities: Vec<f64>,
    /// Two nodes and the conductance between them, W/K.
    pub conductors: Vec<(usize, usize, f64)>,
}

/// A symmetric positive definite matrix as its Cholesky factor, by rows of the lower triangle.
struct Factor(Vec<Vec<f64>>);

impl Factor {
    /// Factors a matrix that is diagonally dominant with a positive diagonal, as those of a network are.
    fn new(mut matrix: Vec<Vec<f64>>) -> Self {
        for column in 0..matrix.len() {
            for row in column..matrix.len() {
                let known: f64 = matrix[row][..column].iter().zip(&matrix[column][..column]).map(|(a, b)| a * b).sum();
                let value = matrix[row][column] - known;
                matrix[row][column] = if row == column { libm::sqrt(value) } else { value / matrix[column][column] };
            }
        }
        Self(matrix)
    }

    /// Solves in place.
    fn solve(&self, right: &mut [f64]) {
        let lower = &self.0;
        for row in 0..right.len() {
            for column in 0..row {
                right[row] -= lower[row][column] * right[column];
            }
            right[row] /= lower[row][row];
        }
        for row in (0..right.len()).rev() {
            for below in row + 1..right.len() {
                right[row] -= lower[below][row] * right[below];
            }
            right[row] /= lower[row][row];
        }
    }
}

impl Network {
    fn conductance_matrix(&self, boundaries: &[Boundary]) -> Vec<Vec<f64>> {
        let count = self.capacities.len();
        let mut matrix = vec![vec![0.0; count]; count];
        for &(one, other, conductance) in &self.conductors {
            matrix[one][one] += conductance;
            matrix[other][other] += conductance;
            matrix[one][other] -= conductance;
            matrix[other][one] -= conductance;
        }
        for boundary in boundaries {
            matrix[boundary.node][boundary.node] += boundary.conductance;
        }
        matrix
    }

    /// The temperatures (°C) at which nothing changes; `watts` are the sources of the nodes.
    ///
    /// Every node must be joined to a boundary, directly or through others.
    pub(super) fn steady(&self, boundaries: &[Boundary], watts: &[f64]) -> Vec<f64> {
        let mut temperatures = watts.to_vec();
        for boundary in boundaries {
            temperatures[boundary.node] += boundary.conductance * boundary.celsius;
        }
        Factor::new(self.conductance_matrix(boundaries)).solve(&mut temperatures);
        temperatures
    }

    /// Prepares steps of `step_s` under boundary conductances that stay; the boundaries' temperatures may change.
    pub(super) fn stepper(&self, boundaries: &[Boundary], step_s: f64) -> Stepper {
        let conductances = self.conductance_matrix(boundaries);
        let mut matrix = conductances.clone();
        for (row, values) in matrix.iter_mut().enumerate() {
            for value in values.iter_mut() {
                *value /= 2.0;
            }
            values[row] += self.capacities[row] / step_s;
        }
        Stepper { conductances, factor: Factor::new(matrix) }
    }
}

/// A network ready for steps of one length.
pub(super) struct Stepper {
    conductances: Vec<Vec<f64>>,
    factor: Factor,
}

impl Stepper {
    /// Advances the temperatures by one step; `boundaries` hold the temperatures at its middle.
    pub(super) fn advance(&self, temperatures: &mut [f64], boundaries: &[Boundary], watts: &[f64]) {
        let mut change = watts.to_vec();
        for boundary in boundaries {
            change[boundary.node] += boundary.conductance * boundary.celsius;
        }
        for (value, row) in change.iter_mut().zip(&self.conductances) {
            for (conductance, temperature) in row.iter().zip(temperatures.iter()) {
                *value -= conductance * temperature;
            }
        }
        self.factor.solve(&mut change);
        for (temperature, change) in temperatures.iter_mut().zip(change) {
            *temperature += change;
        }
    }
}

/// Temperatures over time, linear between the ends of steps.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Trajectory {
    /// s, ascending.
    pub times_s: Vec<f64>,
    /// °C of every node (or sensor) at each time.
    pub temperatures: Vec<Vec<f64>>,
}

impl Trajectory {
    /// Adds a time after all others.
    pub(super) fn push(&mut self, time_s: f64, temperatures: Vec<f64>) {
        self.times_s.push(time_s);
        self.temperatures.push(temperatures);
    }

    /// The two entries around a time and the share of the second.
    fn around(&self, time_s: f64) -> (usize, usize, f64) {
        let after = self.times_s.partition_point(|&time| time < time_s).min(self.times_s.len() - 1);
        let before = after.saturating_sub(1);
        let length = self.times_s[after] - self.times_s[before];
        let share = if length > 0.0 { ((time_s - self.times_s[before]) / length).clamp(0.0, 1.0) } else { 0.0 };
        (before, after, share)
    }

    /// One temperature at a time within the trajectory.
    pub(super) fn one_at(&self, place: usize, time_s: f64) -> f64 {
        let (before, after, share) = self.around(time_s);
        let (low, high) = (self.temperatures[before][place], self.temperatures[after][place]);
        low + share * (high - low)
    }

    /// All temperatures at a time within the trajectory.
    pub(super) fn at(&self, time_s: f64) -> Vec<f64> {
        let (before, after, share) = self.around(time_s);
        self.temperatures[before]
            .iter()
            .zip(&self.temperatures[after])
            .map(|(low, high)| low + share * (high - low))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain() -> (Network, Vec<Boundary>, Vec<f64>) {
        let network =
            Network { capacities: vec![5_000.0, 40_000.0, 8_000.0], conductors: vec![(0, 1, 20.0), (1, 2, 5.0)] };
        let boundaries = vec![
            Boundary { node: 1, conductance: 8.0, celsius: 22.0 },
            Boundary { node: 2, conductance: 2.0, celsius: 18.0 },
        ];
        (network, boundaries, vec![120.0, 0.0, 30.0])
    }

    #[test]
    fn steady_state_equals_the_solution_by_hand() {
        let (network, boundaries, watts) = chain();
        // Nodes 1 and 2 see 120 W and 30 W: 8 (T1 - 22) + 5 (T1 - T2) = 120, 2 (T2 - 18) + 5 (T2 - T1) = 30.
        let t1 = (7.0 * 296.0 + 5.0 * 66.0) / (13.0 * 7.0 - 25.0);
        let t2 = (66.0 + 5.0 * t1) / 7.0;
        let expected = [t1 + 120.0 / 20.0, t1, t2];
        let found = network.steady(&boundaries, &watts);
        for (found, expected) in found.iter().zip(expected) {
            // A factorisation of three rows and condition below 100.
            assert!((found - expected).abs() < 1e3 * f64::EPSILON * expected, "{found} {expected}");
        }
        let mut temperatures = vec![20.0; 3];
        let stepper = network.stepper(&boundaries, 60.0);
        for _ in 0..5_000 {
            stepper.advance(&mut temperatures, &boundaries, &watts);
        }
        for (found, expected) in temperatures.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn one_node_rises_exponentially_with_an_error_of_second_order() {
        let network = Network { capacities: vec![10_000.0], conductors: vec![] };
        let boundaries = [Boundary { node: 0, conductance: 10.0, celsius: 20.0 }];
        let error = |steps: u32| {
            let step = 1_000.0 / f64::from(steps);
            let stepper = network.stepper(&boundaries, step);
            let mut temperatures = vec![20.0];
            for _ in 0..steps {
                stepper.advance(&mut temperatures, &boundaries, &[100.0]);
            }
            temperatures[0] - (20.0 + 10.0 * (1.0 - libm::exp(-1.0)))
        };
        // T(τ) of the rule is (1-x/2)^n/(1+x/2)^n ≈ e^-1 (1 - x²/12) with x = step/τ: the error is 10 e^-1 x²/12.
        for steps in [10, 20, 40] {
            let x = 1.0 / f64::from(steps);
            let leading = 10.0 * libm::exp(-1.0) * x * x / 12.0;
            assert!((error(steps) / leading - 1.0).abs() < x, "{steps}: {} {leading}", error(steps));
        }
    }

    #[test]
    fn stored_energy_is_what_sources_and_boundaries_gave() {
        let (network, boundaries, watts) = chain();
        let mut temperatures = vec![20.0, 21.0, 19.0];
        let start = temperatures.clone();
        let step = 300.0;
        let stepper = network.stepper(&boundaries, step);
        let mut given = 0.0;
        for _ in 0..50 {
            let before = temperatures.clone();
            stepper.advance(&mut temperatures, &boundaries, &watts);
            given += step * watts.iter().sum::<f64>();
            for boundary in &boundaries {
                let middle = (before[boundary.node] + temperatures[boundary.node]) / 2.0;
                given += step * boundary.conductance * (boundary.celsius - middle);
            }
        }
        let stored: f64 = (0..3).map(|node| network.capacities[node] * (temperatures[node] - start[node])).sum();
        // 50 steps, each rounding energies of C T ≈ 1e6 J a few dozen times.
        assert!((stored - given).abs() < 50.0 * 50.0 * f64::EPSILON * 53_000.0 * 40.0, "{stored} {given}");
    }

    #[test]
    fn trajectories_are_linear_between_steps_and_end_where_they_end() {
        let mut trajectory = Trajectory::default();
        trajectory.push(0.0, vec![20.0, 5.0]);
        trajectory.push(10.0, vec![30.0, 5.0]);
        assert_eq!(trajectory.at(2.5), vec![22.5, 5.0]);
        assert_eq!(trajectory.one_at(0, 0.0), 20.0);
        assert_eq!(trajectory.one_at(0, 10.0), 30.0);
    }
}
