//! The oracle: it knows the true world and the noise. Derivatives by central differences of the simulation itself, noise
//! whitened, geometry and thermal coefficients projected out; what an effect leaves is its signal.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::world::{Influence, World};

/// The derivatives of all points, whitening and nuisance space of one run.
pub struct Oracle {
    /// By joint, then point.
    joint: Vec<Vec<Vector3<f64>>>,
    /// By parameter, then point.
    parameter: Vec<Vec<Vector3<f64>>>,
    /// The flange's rotation at each point.
    turns: Vec<Matrix3<f64>>,
    /// Positions without effects.
    positions: Vec<Vector3<f64>>,
    /// Points of a block (one visit, or one posture when postures have errors of their own), and the lower Cholesky factor of
    /// its covariance.
    blocks: Vec<(Vec<usize>, DMatrix<f64>)>,
    /// Orthonormal basis of what calibration absorbs.
    nuisance: Basis,
}

/// An orthonormal basis that grows by Gram and Schmidt, twice each for orthogonality to rounding.
#[derive(Debug, Clone, Default)]
pub struct Basis {
    columns: Vec<DVector<f64>>,
}

impl Basis {
    /// Adds what a column has beyond the basis; nothing if that is rounding.
    pub fn add(&mut self, column: &DVector<f64>) {
        const ROUNDING: f64 = 1e-9;
        let whole = libm::sqrt(column.norm_squared());
        let rest = self.beyond(&self.beyond(column));
        let left = libm::sqrt(rest.norm_squared());
        if left > ROUNDING * whole {
            self.columns.push(rest / left);
        }
    }

    /// What a column has beyond the basis.
    pub fn beyond(&self, column: &DVector<f64>) -> DVector<f64> {
        let mut rest = column.clone();
        for q in &self.columns {
            let along = q.dot(&rest);
            rest.axpy(-along, q, 1.0);
        }
        rest
    }

    /// Its columns.
    pub fn into_columns(self) -> Vec<DVector<f64>> {
        self.columns
    }

    /// Its dimension.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }
}

impl Oracle {
    /// The oracle of a world whose reader finds these rises (by sensor, then point) and sees these points.
    pub fn new(world: &World, rises: &[Vec<f64>], seen: &[bool]) -> Self {
        const STEP: f64 = 1e-6;
        let nothing = Influence::default();
        let positions = world.positions(&nothing, &[]);
        let difference = |ahead: Vec<Vector3<f64>>, behind: Vec<Vector3<f64>>| -> Vec<Vector3<f64>> {
            ahead.iter().zip(&behind).map(|(ahead, behind)| (ahead - behind) / (2.0 * STEP)).collect()
        };
        let visits = world.schedule.visits.len();
        let joint = (0..world.arm.joints())
            .map(|joint| {
                let moved = |by: f64| {
                    let joints = vec![(joint, vec![by; visits])];
                    world.positions(&Influence { joints, ..Influence::default() }, &[])
                };
                difference(moved(STEP), moved(-STEP))
            })
            .collect();
        let parameter: Vec<Vec<Vector3<f64>>> = (0..world.values.len())
            .map(|parameter| {
                let moved = |by: f64| {
                    let mut values = world.values.clone();
                    values[parameter] += by;
                    world.positions_from(&values, &nothing, &[])
                };
                difference(moved(STEP), moved(-STEP))
            })
            .collect();
        let turns = world
            .points
            .iter()
            .map(|point| {
                let joints = &world.schedule.visits[point.visit].joints;
                world.arm.flange(&world.values, joints).fixed_view::<3, 3>(0, 0).into_owned()
            })
            .collect();
        let mut oracle = Self { joint, parameter, turns, positions, blocks: Vec::new(), nuisance: Basis::default() };
        oracle.blocks = oracle.covariances(world, seen);
        oracle.nuisance = oracle.nuisance_with(world, rises);
        oracle
    }

    fn covariances(&self, world: &World, seen: &[bool]) -> Vec<(Vec<usize>, DMatrix<f64>)> {
        let by_posture = world.noise.posture.iter().any(|&sigma| sigma > 0.0);
        let key = |p: usize| {
            let visit = world.points[p].visit;
            if by_posture { world.schedule.visits[visit].pose } else { visit }
        };
        let groups = (0..world.points.len()).map(key).max().map_or(0, |last| last + 1);
        let mut members = vec![Vec::new(); groups];
        for p in (0..world.points.len()).filter(|&p| seen[p]) {
            members[key(p)].push(p);
        }
        let blocks = members.into_iter().filter(|members| !members.is_empty()).map(|members| {
            let size = 3 * members.len();
            let covariance = DMatrix::from_fn(size, size, |row, column| {
                let (a, b) = (members[row / 3], members[column / 3]);
                let same_visit = world.points[a].visit == world.points[b].visit;
                let joints: f64 = (0..self.joint.len())
                    .map(|joint| {
                        let visit = if same_visit { world.noise.joint[joint] } else { 0.0 };
                        let posture = world.noise.posture[joint];
                        let variance = visit * visit + posture * posture;
                        self.joint[joint][a][row % 3] * self.joint[joint][b][column % 3] * variance
                    })
                    .sum();
                let sigma = world.noise.at(&self.positions[a]);
                joints + if row == column { sigma * sigma } else { 0.0 }
            });
            let factor = covariance.cholesky().expect("noise of every point makes it positive").unpack();
            (members, factor)
        });
        blocks.collect()
    }

    /// What calibration absorbs when the log says these rises (by sensor, then point): all geometric parameters, and a
    /// coefficient for each pair of robot.toml's growth.
    pub fn nuisance_with(&self, world: &World, rises: &[Vec<f64>]) -> Basis {
        let mut basis = Basis::default();
        let mut absorb = |parameter: usize, values: Vec<f64>| {
            let parameters = vec![(parameter, values)];
            basis.add(&self.column(&Influence { parameters, ..Influence::default() }));
        };
        for parameter in 0..world.values.len() {
            absorb(parameter, vec![1.0; world.points.len()]);
        }
        for pair in &world.arm.thermal {
            for &sensor in &pair.sensors {
                absorb(pair.parameter, rises[sensor].clone());
            }
        }
        basis
    }

    /// An influence on the positions to first order, whitened.
    pub fn column(&self, influence: &Influence) -> DVector<f64> {
        self.whiten(&self.displacements(influence))
    }

    /// An influence on the positions to first order, m.
    pub fn displacements(&self, influence: &Influence) -> Vec<Vector3<f64>> {
        let mut moved = vec![Vector3::zeros(); self.positions.len()];
        for (parameter, changes) in &influence.parameters {
            for (p, at) in moved.iter_mut().enumerate() {
                *at += self.parameter[*parameter][p] * changes[p];
            }
        }
        let visits = influence.joints.first().map_or(0, |(_, angles)| angles.len());
        let targets = self.positions.len().checked_div(visits).unwrap_or(1);
        for (joint, angles) in &influence.joints {
            for (p, at) in moved.iter_mut().enumerate() {
                *at += self.joint[*joint][p] * angles[p / targets];
            }
        }
        for (p, shift) in influence.flange.iter().enumerate() {
            moved[p] += self.turns[p] * shift;
        }
        for (p, (turn, shift)) in influence.world.iter().enumerate() {
            moved[p] += turn * self.positions[p] + shift;
        }
        moved
    }

    /// Displacements of all points in units of the noise: those that are seen, block by block.
    pub fn whiten(&self, displacements: &[Vector3<f64>]) -> DVector<f64> {
        let mut white = Vec::with_capacity(3 * displacements.len());
        for (members, factor) in &self.blocks {
            let rows: Vec<f64> = members.iter().flat_map(|&p| [0, 1, 2].map(|axis| displacements[p][axis])).collect();
            let solved = factor.solve_lower_triangular(&DVector::from_vec(rows)).expect("a positive diagonal");
            white.extend_from_slice(solved.as_slice());
        }
        DVector::from_vec(white)
    }

    /// What of a whitened column calibration does not absorb.
    pub fn visible(&self, column: &DVector<f64>) -> DVector<f64> {
        self.nuisance.beyond(column)
    }

    /// What calibration absorbs.
    pub fn nuisance(&self) -> &Basis {
        &self.nuisance
    }

    /// The growth of all thermal parameters, as an influence: what readings of the bodies explain.
    pub fn growth(world: &World) -> Influence {
        let parameters =
            world.growth.iter().zip(&world.grown).map(|(growth, grown)| (growth.parameter, grown.clone())).collect();
        Influence { parameters, ..Influence::default() }
    }
}

/// The length of a vector.
pub fn length(column: &DVector<f64>) -> f64 {
    libm::sqrt(column.norm_squared())
}
