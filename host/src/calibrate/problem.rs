//! The least-squares problem: whitened residuals of every visit and their derivatives, pushed into an orthogonal factor.
//!
//! Residuals are measured minus predicted, seen in the flange frame and divided by their standard deviation; columns are
//! the derivatives of the prediction. The targets of a visit share one twist of the flange. Where their places are known,
//! the rows of a visit are therefore `A S` with `A` (3 × targets by 6) the same for every visit that sees these targets and
//! `S` the twists of the parameters: with `A = Q R`, the six rows `R S` and `Qᵀe` hold all that a visit says about the
//! arm, however many targets it has; the rest of `e` is noise within the visit.

use nalgebra::{DMatrix, Vector3};

use super::campaign::{Campaign, ObservedVisit};
use super::factor::OrthogonalFactor;
use super::unknown::{State, Unknown};
use crate::robot::{Frame, Prepared, Twist};

/// Targets that are seen together: the orthogonal factor of what a twist of the flange does to them.
#[derive(Debug, Clone)]
struct Pattern {
    /// The targets, in the order of the visit's positions.
    names: Vec<usize>,
    /// Their places in the flange frame.
    targets: Vec<[f64; 3]>,
    /// Columns of `Q` by targets: 3 × targets by 6.
    q: Vec<[f64; 6]>,
    /// Upper triangle of `R`, by columns.
    r: [[f64; 6]; 6],
}

impl Pattern {
    /// # Panics
    /// With fewer than two targets, where a visit has no more than six rows.
    fn new(names: Vec<usize>, state: &State) -> Self {
        let targets: Vec<[f64; 3]> = names.iter().map(|&target| state.geometry.targets[target].into()).collect();
        let rows = 3 * targets.len();
        let a = DMatrix::from_fn(rows, 6, |row, column| {
            let mut twist = Twist::default();
            match column {
                0..3 => twist.angular[column] = 1.0,
                _ => twist.linear[column - 3] = 1.0,
            }
            twist.at(&targets[row / 3])[row % 3]
        });
        let qr = a.qr();
        let (q, r) = (qr.q(), qr.r());
        Self {
            names,
            targets,
            q: (0..rows).map(|row| std::array::from_fn(|column| q[(row, column)])).collect(),
            r: std::array::from_fn(|column| {
                std::array::from_fn(|row| if row <= column { r[(row, column)] } else { 0.0 })
            }),
        }
    }

    /// `R` times a twist.
    #[inline(always)]
    fn rows(&self, twist: &Twist, scale: f64) -> [f64; 6] {
        let parts = [
            twist.angular[0] * scale,
            twist.angular[1] * scale,
            twist.angular[2] * scale,
            twist.linear[0] * scale,
            twist.linear[1] * scale,
            twist.linear[2] * scale,
        ];
        let mut rows = [0.0; 6];
        for (column, part) in self.r.iter().zip(parts) {
            for (row, entry) in rows.iter_mut().zip(column) {
                *row += entry * part;
            }
        }
        rows
    }
}

/// Which columns an unknown parameter fills, by growth with temperature too.
#[derive(Debug, Clone, Default)]
struct Columns {
    /// For each parameter its column.
    parameter: Vec<Option<usize>>,
    /// For each target coordinate its column.
    target: Vec<[Option<usize>; 3]>,
    turn: Vec<[Option<usize>; 3]>,
    anchor: Vec<[Option<usize>; 3]>,
    /// For each free growth term: parameter, sensor, column.
    growth: Vec<(usize, usize, usize)>,
}

/// A campaign with a choice of unknowns.
#[derive(Debug, Clone)]
pub struct Problem<'a> {
    campaign: &'a Campaign,
    unknowns: Vec<Unknown>,
    columns: Columns,
    /// Parameter and column of every free parameter: the inner loop's list.
    free_parameters: Vec<(usize, usize)>,
    /// One for each set of targets that visits see together, where their places are known; a visit without one has a row
    /// for every scalar.
    patterns: Vec<Pattern>,
    /// Factor on each scalar's row by robust weighting, visit after visit; none: all one.
    weights: Option<Vec<f64>>,
}

/// Whether six rows hold all that a visit says about the arm.
fn compressible(visit: &ObservedVisit) -> bool {
    visit.positions.len() >= 3 && visit.turns.is_empty() && visit.distances.is_empty()
}

/// Scratch space for one visit's derivatives.
#[derive(Debug, Clone)]
pub struct Scratch {
    parameters: Vec<Twist>,
    joints: Vec<Twist>,
}

/// The residuals and derivatives of one visit as dense numbers, for what needs to look at single visits.
#[derive(Debug, Clone)]
pub struct VisitRows {
    /// Rows by unknowns, whitened.
    pub jacobian: DMatrix<f64>,
    /// Rows by joints, whitened.
    pub joints: DMatrix<f64>,
    /// Whitened residuals.
    pub residual: nalgebra::DVector<f64>,
}

impl<'a> Problem<'a> {
    /// The problem of finding `unknowns` from a campaign; `state` gives the places of targets that are not unknown.
    pub fn new(campaign: &'a Campaign, unknowns: Vec<Unknown>, state: &State) -> Self {
        let mut columns = Columns {
            parameter: vec![None; campaign.chain.parameters().len()],
            target: vec![[None; 3]; campaign.targets.len()],
            turn: vec![[None; 3]; campaign.targets.len()],
            anchor: vec![[None; 3]; campaign.anchors.len()],
            growth: Vec::new(),
        };
        let mut free_parameters = Vec::new();
        for (column, &unknown) in unknowns.iter().enumerate() {
            match unknown {
                Unknown::Parameter(place) => {
                    columns.parameter[place] = Some(column);
                    free_parameters.push((place, column));
                }
                Unknown::Target { target, axis } => columns.target[target][axis] = Some(column),
                Unknown::Turn { target, axis } => columns.turn[target][axis] = Some(column),
                Unknown::Anchor { anchor, axis } => columns.anchor[anchor][axis] = Some(column),
                Unknown::Growth(term) => {
                    let growth = campaign.growth[term];
                    columns.growth.push((growth.parameter, growth.sensor, column));
                }
            }
        }
        let mut problem = Self { campaign, unknowns, columns, free_parameters, patterns: Vec::new(), weights: None };
        problem.find_patterns(state);
        problem
    }

    /// Finds the sets of targets that visits see together.
    fn find_patterns(&mut self, state: &State) {
        self.patterns.clear();
        if self.weights.is_some() || self.columns.target.iter().flatten().any(Option::is_some) {
            return;
        }
        for visit in &self.campaign.visits {
            if compressible(visit) && self.pattern(visit).is_none() {
                let names = visit.positions.iter().map(|position| position.target).collect();
                self.patterns.push(Pattern::new(names, state));
            }
        }
    }

    /// The pattern of a visit's targets. There are few: as a rule all targets, and those sets that a broken beam leaves.
    fn pattern(&self, visit: &ObservedVisit) -> Option<&Pattern> {
        let seen = || visit.positions.iter().map(|position| position.target);
        self.patterns
            .iter()
            .find(|pattern| pattern.names.iter().copied().eq(seen()))
            .filter(|_| visit.turns.is_empty() && visit.distances.is_empty())
    }

    /// The unknowns, one a column.
    pub fn unknowns(&self) -> &[Unknown] {
        &self.unknowns
    }

    /// The campaign.
    pub fn campaign(&self) -> &'a Campaign {
        self.campaign
    }

    /// Multiplies each scalar's row by a factor, in the order of visits, positions, turns, distances.
    ///
    /// # Panics
    /// When there is not one factor for each scalar.
    pub fn set_weights(&mut self, weights: Vec<f64>, state: &State) {
        assert_eq!(weights.len(), self.campaign.rows(), "one weight a scalar");
        self.weights = Some(weights);
        self.find_patterns(state);
    }

    /// Scratch space for this problem.
    pub fn scratch(&self) -> Scratch {
        Scratch {
            parameters: vec![Twist::default(); self.campaign.chain.parameters().len()],
            joints: vec![Twist::default(); self.campaign.chain.joint_count()],
        }
    }

    /// The chain with growth at a visit; none where nothing grows.
    fn prepared_at(&self, visit: &ObservedVisit, state: &State) -> Option<Prepared> {
        if self.campaign.growth.is_empty() {
            return None;
        }
        let mut values = state.geometry.parameters.clone();
        for (term, coefficient) in self.campaign.growth.iter().zip(&state.growth) {
            values[term.parameter] += coefficient * visit.rises[term.sensor];
        }
        Some(self.campaign.chain.prepare(&values))
    }

    /// Calls `act` with every visit, its chain and the place of its first row among all.
    fn each_visit(&self, state: &State, mut act: impl FnMut(&'a ObservedVisit, &Prepared, usize)) {
        let base = self.campaign.chain.prepare(&state.geometry.parameters);
        let mut first_row = 0;
        for visit in &self.campaign.visits {
            match self.prepared_at(visit, state) {
                Some(prepared) => act(visit, &prepared, first_row),
                None => act(visit, &base, first_row),
            }
            first_row += visit.rows();
        }
    }

    /// Whitened residuals of a visit, row by row, given to `push` with their weights already applied.
    fn residuals(
        &self,
        visit: &ObservedVisit,
        flange: &Frame,
        state: &State,
        first_row: usize,
        mut push: impl FnMut(f64),
    ) {
        let mut row = first_row;
        let mut weigh = |value: f64| {
            let weight = self.weights.as_ref().map_or(1.0, |weights| weights[row]);
            row += 1;
            push(weight * value);
        };
        for position in &visit.positions {
            let e = (flange.local(&position.at) - state.geometry.targets[position.target]) / visit.sigma;
            e.iter().for_each(|&value| weigh(value));
        }
        for turn in &visit.turns {
            // Measured against predicted orientation, as a small turn about the flange's axes.
            let own = state.geometry.turns[turn.target];
            let e = (flange.quaternion().inverse() * turn.at * own.inverse()).scaled_axis() / visit.turn_sigma;
            e.iter().for_each(|&value| weigh(value));
        }
        for distance in &visit.distances {
            let away = flange.point(&state.geometry.targets[distance.target]) - state.geometry.anchors[distance.anchor];
            weigh((distance.distance - away.norm()) / distance.sigma);
        }
    }

    /// Half the sum of squared whitened residuals: the loss of thesis section 4.4.1.
    pub fn loss(&self, state: &State) -> f64 {
        let mut sum = 0.0;
        self.each_visit(state, |visit, prepared, first_row| {
            let flange = prepared.flange(&visit.posture);
            self.residuals(visit, &flange, state, first_row, |value| sum += value * value);
        });
        0.5 * sum
    }

    /// All whitened residuals without robust weights, visit after visit.
    pub fn whitened(&self, state: &State) -> Vec<f64> {
        let plain = Problem { weights: None, ..self.clone() };
        let mut all = Vec::with_capacity(self.campaign.rows());
        plain.each_visit(state, |visit, prepared, first_row| {
            let flange = prepared.flange(&visit.posture);
            plain.residuals(visit, &flange, state, first_row, |value| all.push(value));
        });
        all
    }

    /// Distances between measured and predicted target positions, metres: visit, then each of its positions.
    pub fn distances(&self, state: &State, mut each: impl FnMut(&ObservedVisit, usize, Vector3<f64>)) {
        self.each_visit(state, |visit, prepared, _| {
            let flange = prepared.flange(&visit.posture);
            for position in &visit.positions {
                let predicted = flange.point(&state.geometry.targets[position.target]);
                each(visit, position.target, position.at - predicted);
            }
        });
    }

    /// Pushes the rows of all visits at a state into a cleared factor and folds it. Returns the loss.
    pub fn linearise(&self, state: &State, scratch: &mut Scratch, factor: &mut OrthogonalFactor) -> f64 {
        factor.clear();
        let mut sum = 0.0;
        self.each_visit(state, |visit, prepared, first_row| {
            sum += self.push_visit(visit, prepared, state, first_row, scratch, factor);
        });
        factor.fold();
        0.5 * sum
    }

    /// Whether [`Problem::gradient`] can be had: positions alone, each with its full weight.
    pub fn has_gradient(&self) -> bool {
        self.weights.is_none()
            && self.campaign.visits.iter().all(|visit| visit.turns.is_empty() && visit.distances.is_empty())
    }

    /// The gradient `Jᵀe` at a state without the rows of `J`, and the loss. Only where [`Problem::has_gradient`].
    ///
    /// The residuals of a visit are forces at its targets; what they do along a parameter's twist is the product of twist
    /// and wrench.
    pub fn gradient(&self, state: &State, scratch: &mut Scratch, gradient: &mut Vec<f64>) -> f64 {
        gradient.clear();
        gradient.resize(self.unknowns.len(), 0.0);
        let mut sum = 0.0;
        self.each_visit(state, |visit, prepared, _| {
            let flange = prepared.twists(&visit.posture, &mut scratch.parameters, &mut scratch.joints);
            let weight = 1.0 / (visit.sigma * visit.sigma);
            let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
            for position in &visit.positions {
                let place = &state.geometry.targets[position.target];
                let e = flange.local(&position.at) - place;
                sum += weight * e.norm_squared();
                force += e;
                moment += place.cross(&e);
                for (axis, column) in self.columns.target[position.target].iter().enumerate() {
                    if let Some(column) = *column {
                        gradient[column] += weight * e[axis];
                    }
                }
            }
            force *= weight;
            moment *= weight;
            let along = |twist: &Twist| {
                let [wx, wy, wz] = twist.angular;
                let [vx, vy, vz] = twist.linear;
                (wx * moment.x + wy * moment.y + wz * moment.z) + (vx * force.x + vy * force.y + vz * force.z)
            };
            for &(place, column) in &self.free_parameters {
                gradient[column] += along(&scratch.parameters[place]);
            }
            for &(place, sensor, column) in &self.columns.growth {
                gradient[column] += along(&scratch.parameters[place]) * visit.rises[sensor];
            }
        });
        0.5 * sum
    }

    /// Pushes the rows of one visit. Returns its sum of squares, what lies within the visit included.
    fn push_visit(
        &self,
        visit: &ObservedVisit,
        prepared: &Prepared,
        state: &State,
        first_row: usize,
        scratch: &mut Scratch,
        factor: &mut OrthogonalFactor,
    ) -> f64 {
        let flange = prepared.twists(&visit.posture, &mut scratch.parameters, &mut scratch.joints);
        match self.pattern(visit) {
            Some(pattern) => self.push_compressed(visit, &flange, pattern, scratch, factor),
            None => self.push_full(visit, &flange, state, first_row, scratch, factor),
        }
    }

    fn push_compressed(
        &self,
        visit: &ObservedVisit,
        flange: &Frame,
        pattern: &Pattern,
        scratch: &Scratch,
        factor: &mut OrthogonalFactor,
    ) -> f64 {
        let scale = 1.0 / visit.sigma;
        let mut rows = factor.push(6);
        for &(place, column) in &self.free_parameters {
            rows.column(column).copy_from_slice(&pattern.rows(&scratch.parameters[place], scale));
        }
        for &(place, sensor, column) in &self.columns.growth {
            let rise = scale * visit.rises[sensor];
            rows.column(column).copy_from_slice(&pattern.rows(&scratch.parameters[place], rise));
        }
        let mut right = [0.0; 6];
        let mut sum = 0.0;
        for ((position, target), q) in visit.positions.iter().zip(&pattern.targets).zip(pattern.q.chunks_exact(3)) {
            let seen = flange.local(&position.at);
            for axis in 0..3 {
                let e = (seen[axis] - target[axis]) * scale;
                sum += e * e;
                for (value, entry) in right.iter_mut().zip(&q[axis]) {
                    *value += entry * e;
                }
            }
        }
        rows.right_hand_side().copy_from_slice(&right);
        sum
    }

    fn push_full(
        &self,
        visit: &ObservedVisit,
        flange: &Frame,
        state: &State,
        first_row: usize,
        scratch: &Scratch,
        factor: &mut OrthogonalFactor,
    ) -> f64 {
        let mut residuals = Vec::with_capacity(visit.rows());
        self.residuals(visit, flange, state, first_row, |value| residuals.push(value));
        let mut done = 0;
        let weight = |row: usize| self.weights.as_ref().map_or(1.0, |weights| weights[first_row + row]);
        for position in &visit.positions {
            let place = state.geometry.targets[position.target].into();
            let scales: [f64; 3] = std::array::from_fn(|axis| weight(done + axis) / visit.sigma);
            let mut rows = factor.push(3);
            let mut write = |column: usize, values: [f64; 3], factor: f64| {
                for (axis, entry) in rows.column(column).iter_mut().enumerate() {
                    *entry = values[axis] * scales[axis] * factor;
                }
            };
            for &(parameter, column) in &self.free_parameters {
                write(column, scratch.parameters[parameter].at(&place), 1.0);
            }
            for &(parameter, sensor, column) in &self.columns.growth {
                write(column, scratch.parameters[parameter].at(&place), visit.rises[sensor]);
            }
            for (axis, column) in self.columns.target[position.target].iter().enumerate() {
                if let Some(column) = column {
                    rows.set(axis, *column, scales[axis]);
                }
            }
            rows.right_hand_side().copy_from_slice(&residuals[done..done + 3]);
            done += 3;
        }
        for turn in &visit.turns {
            let scales: [f64; 3] = std::array::from_fn(|axis| weight(done + axis) / visit.turn_sigma);
            let mut rows = factor.push(3);
            let mut write = |column: usize, values: [f64; 3], factor: f64| {
                for (axis, entry) in rows.column(column).iter_mut().enumerate() {
                    *entry = values[axis] * scales[axis] * factor;
                }
            };
            for &(parameter, column) in &self.free_parameters {
                write(column, scratch.parameters[parameter].angular, 1.0);
            }
            for &(parameter, sensor, column) in &self.columns.growth {
                write(column, scratch.parameters[parameter].angular, visit.rises[sensor]);
            }
            for (axis, column) in self.columns.turn[turn.target].iter().enumerate() {
                if let Some(column) = column {
                    rows.set(axis, *column, scales[axis]);
                }
            }
            rows.right_hand_side().copy_from_slice(&residuals[done..done + 3]);
            done += 3;
        }
        for distance in &visit.distances {
            let place = state.geometry.targets[distance.target];
            let away = flange.point(&place) - state.geometry.anchors[distance.anchor];
            let norm = away.norm();
            let direction = if norm > 0.0 { away / norm } else { Vector3::zeros() };
            let seen = flange.rotation.tr_mul(&direction);
            let scale = weight(done) / distance.sigma;
            let place = place.into();
            let along = |twist: &Twist| seen.dot(&Vector3::from(twist.at(&place))) * scale;
            let mut rows = factor.push(1);
            for &(parameter, column) in &self.free_parameters {
                rows.set(0, column, along(&scratch.parameters[parameter]));
            }
            for &(parameter, sensor, column) in &self.columns.growth {
                rows.set(0, column, along(&scratch.parameters[parameter]) * visit.rises[sensor]);
            }
            for axis in 0..3 {
                if let Some(column) = self.columns.target[distance.target][axis] {
                    rows.set(0, column, seen[axis] * scale);
                }
                if let Some(column) = self.columns.anchor[distance.anchor][axis] {
                    rows.set(0, column, -direction[axis] * scale);
                }
            }
            rows.right_hand_side()[0] = residuals[done];
            done += 1;
        }
        residuals.iter().map(|value| value * value).sum()
    }

    /// The rows of every visit, one at a time: Jacobian, derivative by the joints, residual, all whitened and with robust
    /// weights applied. Every scalar is a row here, whatever the layout.
    pub fn each_visit_rows(&self, state: &State, mut each: impl FnMut(&'a ObservedVisit, VisitRows)) {
        let mut scratch = self.scratch();
        let unknowns = self.unknowns.len();
        let most = self.campaign.visits.iter().map(ObservedVisit::rows).max().unwrap_or(0);
        let mut factor = OrthogonalFactor::with_capacity(unknowns, most);
        self.each_visit(state, |visit, prepared, first_row| {
            let flange = prepared.twists(&visit.posture, &mut scratch.parameters, &mut scratch.joints);
            factor.clear();
            self.push_full(visit, &flange, state, first_row, &scratch, &mut factor);
            let jacobian = factor.waiting_rows();
            let rows = jacobian.nrows();
            let joints = self.joint_rows(visit, &flange, state, first_row, &scratch, rows);
            each(
                visit,
                VisitRows {
                    residual: jacobian.column(unknowns).into_owned(),
                    jacobian: jacobian.columns(0, unknowns).into_owned(),
                    joints,
                },
            );
        });
    }

    /// The part of the loss's Hessian that Gauss and Newton leave out, `-Σ e ∂²r`: exact, for geometric unknowns seen by
    /// positions.
    ///
    /// With every parameter's twist in the flange frame, the second derivative of a target's position by a parameter and
    /// by one further down the chain is `ω₁ × (ω₂ × p + v₂)`: upstream acts on what downstream does.
    pub fn curvature(&self, state: &State) -> DMatrix<f64> {
        let mut scratch = self.scratch();
        let unknowns = self.unknowns.len();
        let mut hessian = DMatrix::zeros(unknowns, unknowns);
        self.each_visit(state, |visit, prepared, _| {
            let flange = prepared.twists(&visit.posture, &mut scratch.parameters, &mut scratch.joints);
            for position in &visit.positions {
                let target = &state.geometry.targets[position.target];
                let e = (flange.local(&position.at) - target) / (visit.sigma * visit.sigma);
                let place = (*target).into();
                // e · (ω × u) = u · (e × ω).
                let lever = |twist: &Twist| e.cross(&Vector3::from(twist.angular));
                for &(upstream, i) in &self.free_parameters {
                    let lever = lever(&scratch.parameters[upstream]);
                    for &(downstream, j) in &self.free_parameters {
                        if downstream >= upstream {
                            let value = -lever.dot(&Vector3::from(scratch.parameters[downstream].at(&place)));
                            hessian[(i, j)] += value;
                            if downstream > upstream {
                                hessian[(j, i)] += value;
                            }
                        }
                    }
                    for (axis, column) in self.columns.target[position.target].iter().enumerate() {
                        if let Some(j) = *column {
                            hessian[(i, j)] -= lever[axis];
                            hessian[(j, i)] -= lever[axis];
                        }
                    }
                }
            }
        });
        hessian
    }

    fn joint_rows(
        &self,
        visit: &ObservedVisit,
        flange: &Frame,
        state: &State,
        first_row: usize,
        scratch: &Scratch,
        rows: usize,
    ) -> DMatrix<f64> {
        let mut matrix = DMatrix::zeros(rows, scratch.joints.len());
        for (joint, twist) in scratch.joints.iter().enumerate() {
            let mut row = 0;
            let mut write = |value: f64| {
                let weight = self.weights.as_ref().map_or(1.0, |weights| weights[first_row + row]);
                matrix[(row, joint)] = weight * value;
                row += 1;
            };
            for position in &visit.positions {
                let at = twist.at(&state.geometry.targets[position.target].into());
                at.iter().for_each(|value| write(value / visit.sigma));
            }
            for _ in &visit.turns {
                twist.angular.iter().for_each(|value| write(value / visit.turn_sigma));
            }
            for distance in &visit.distances {
                let place = state.geometry.targets[distance.target];
                let away = flange.point(&place) - state.geometry.anchors[distance.anchor];
                let seen = flange.rotation.tr_mul(&away.try_normalize(0.0).unwrap_or_default());
                write(seen.dot(&Vector3::from(twist.at(&place.into()))) / distance.sigma);
            }
        }
        matrix
    }
}
