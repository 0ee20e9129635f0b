//! How warm the arm is: the scenario's heat as a network, driven by the timetable.

use super::arm::node_place;
use super::heat::{Boundary, Network, Trajectory};
use super::scenario::{Heat, Node};
use crate::robot::Robot;
use crate::run::MotionStep;

/// A step of the integration, as the sensors need to know it.
pub(super) struct Interval {
    pub start_s: f64,
    pub end_s: f64,
    /// Root-sum-square speed of the joints up to each link, rad/s.
    pub link_speeds: Vec<f64>,
}

/// The temperatures of all nodes over the whole timetable.
pub(super) struct Warmth {
    pub nodes: Trajectory,
    /// Between each two times of `nodes`.
    pub intervals: Vec<Interval>,
}

/// The transform that each joint moves, which is also the link beyond the joint.
fn links_of_joints(robot: &Robot) -> Vec<usize> {
    robot
        .transforms
        .iter()
        .enumerate()
        .filter(|(_, transform)| transform.joint.is_some())
        .map(|(link, _)| link)
        .collect()
}

/// The network of the links: cores to their housings, cores to the next cores.
fn network(heat: &Heat) -> Network {
    let mut network = Network::default();
    for (number, link) in heat.links.iter().enumerate() {
        network.capacities.extend([link.core_j_per_k, link.housing_j_per_k]);
        let core = node_place(number, Node::Core);
        network.conductors.push((core, node_place(number, Node::Housing), link.inside_w_per_k));
        if number + 1 < heat.links.len() {
            network.conductors.push((core, node_place(number + 1, Node::Core), link.next_w_per_k));
        }
    }
    network
}

/// The housings' boundaries: air for all, the floor for the first.
fn boundaries(heat: &Heat, link_speeds: &[f64], air_c: f64) -> Vec<Boundary> {
    let floor = Boundary { node: node_place(0, Node::Housing), conductance: heat.floor_w_per_k, celsius: heat.floor_c };
    let air = heat.links.iter().zip(link_speeds).enumerate().map(|(number, (link, speed))| Boundary {
        node: node_place(number, Node::Housing),
        conductance: link.air_w_per_k + link.moving_w_per_k * speed,
        celsius: air_c,
    });
    [floor].into_iter().chain(air).collect()
}

/// The losses of the joints at their speeds, W into each node. An arm at rest before the run is switched off.
fn losses(heat: &Heat, links: &[usize], speeds: &[f64]) -> Vec<f64> {
    let mut watts = vec![0.0; 2 * heat.links.len()];
    for ((joint, &link), speed) in heat.joints.iter().zip(links).zip(speeds) {
        let loss = joint.holding_w + joint.coulomb * speed + joint.viscous * speed * speed;
        watts[node_place(link, Node::Core)] += joint.beyond * loss;
        watts[node_place(link - 1, Node::Core)] += (1.0 - joint.beyond) * loss;
    }
    watts
}

fn speeds_of_links(links: &[usize], speeds: &[f64], count: usize) -> Vec<f64> {
    (0..count)
        .map(|number| {
            let moved = links.iter().zip(speeds).filter(|(link, _)| **link <= number);
            libm::sqrt(moved.map(|(_, speed)| speed * speed).sum())
        })
        .collect()
}

/// Integrates over the steps of the timetable from the state in which the arm has stood for long, switched off.
pub(super) fn warmth(robot: &Robot, heat: &Heat, steps: &[MotionStep]) -> Warmth {
    let network = network(heat);
    let links = links_of_joints(robot);
    let count = heat.links.len();
    let still = vec![0.0; count];
    let mut now_c = network.steady(&boundaries(heat, &still, heat.ambient.celsius(0.0)), &vec![0.0; 2 * count]);
    let mut nodes = Trajectory::default();
    let mut intervals = Vec::new();
    nodes.push(0.0, now_c.clone());
    for step in steps {
        let link_speeds = speeds_of_links(&links, &step.rms, count);
        let watts = losses(heat, &links, &step.rms);
        let length = step.end_s - step.start_s;
        let parts = libm::ceil(length / heat.step_s).max(1.0);
        let stepper = network.stepper(&boundaries(heat, &link_speeds, 0.0), length / parts);
        for part in 0..parts as usize {
            let start_s = step.start_s + length * part as f64 / parts;
            let end_s = step.start_s + length * (part + 1) as f64 / parts;
            let air_c = heat.ambient.celsius((start_s + end_s) / 2.0);
            stepper.advance(&mut now_c, &boundaries(heat, &link_speeds, air_c), &watts);
            nodes.push(end_s, now_c.clone());
            intervals.push(Interval { start_s, end_s, link_speeds: link_speeds.clone() });
        }
    }
    Warmth { nodes, intervals }
}
