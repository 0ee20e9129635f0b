//! A module of Python that evaluates the model with numpy alone.

use super::portable::{Portable, number, numbers, plain};

/// The text of the module.
pub fn python(model: &Portable) -> String {
    let rows = |rows: Vec<String>| rows.iter().map(|row| format!("    {row},\n")).collect::<String>();
    let transforms = model.transforms.iter().map(|one| format!("([{}], {})", numbers(&one.values), one.moves));
    let growth = model.growth.iter().map(|one| {
        format!("({}, {}, {}, {}, {})", one.transform, one.symbol, one.sensor, number(one.linear), number(one.square))
    });
    let effects = model.effects.iter().map(|one| {
        let values = numbers(&[one.harmonic, one.cosine, one.sine, one.ratio, one.step]);
        format!("({}, {}, {values})", one.joint, one.from)
    });
    let sensors = model
        .sensors
        .iter()
        .map(|(name, celsius)| format!("({}, {})", serde_json::Value::from(name.as_str()), number(*celsius)));
    format!(
        r#""""{name}: forward kinematics of its thermokin model, with numpy alone.

Metres, radians, degrees Celsius. The world is the frame of the tracker that the arm was calibrated with.
"""
import numpy as np

# [d, theta, a, alpha, b, beta] of Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta), and what the joint adds to:
# 0 nothing, 1 theta, 2 d. The first leads from the world to the base.
TRANSFORMS = [
{transforms}]
# Name and reference temperature.
SENSORS = [
{sensors}]
# (transform, place in its values, sensor, per K, per K^2)
GROWTH = [
{growth}]
# (joint, joint that it follows, harmonic, cosine, sine, ratio, step): added to the joint.
EFFECTS = [
{effects}]
JOINTS = {joints}


def _turn(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    m = np.eye(4)
    m[i, i], m[i, j], m[j, i], m[j, j] = c, -s, s, c
    return m


def _move(axis, length):
    m = np.eye(4)
    m[axis, 3] = length
    return m


def forward(q, celsius=None, approach=None):
    """The flange in the world as a 4 x 4 matrix, at the joints that the controller reads.

    celsius: temperatures by sensor name; those that are not given count as at the reference.
    approach: the sign of each joint's last motion, -1, 0 or 1.
    """
    q = np.asarray(q, dtype=float)
    if q.shape != (JOINTS,):
        raise ValueError(f"expected {{JOINTS}} joints")
    celsius = dict(celsius or {{}})
    unknown = set(celsius) - {{name for name, _ in SENSORS}}
    if unknown:
        raise ValueError(f"no such sensor: {{sorted(unknown)}}")
    approach = np.zeros(JOINTS) if approach is None else np.asarray(approach, dtype=float)
    rises = [celsius.get(name, reference) - reference for name, reference in SENSORS]
    values = np.array([values for values, _ in TRANSFORMS])
    for transform, place, sensor, per_k, per_k2 in GROWTH:
        values[transform, place] += per_k * rises[sensor] + per_k2 * rises[sensor] ** 2
    stands = q.copy()
    for joint, source, harmonic, cosine, sine, ratio, step in EFFECTS:
        wave = cosine * np.cos(harmonic * q[source]) + sine * np.sin(harmonic * q[source])
        stands[joint] += wave + ratio * q[source] + step * approach[joint]
    place = np.eye(4)
    joint = 0
    for (d, theta, a, alpha, b, beta), (_, moves) in zip(values, TRANSFORMS):
        if moves == 1:
            theta += stands[joint]
        elif moves == 2:
            d += stands[joint]
        joint += moves > 0
        place = place @ _move(2, d) @ _turn(2, theta) @ _move(0, a) @ _turn(0, alpha) @ _move(1, b) @ _turn(1, beta)
    return place
"#,
        name = plain(&model.name),
        transforms = rows(transforms.collect()),
        sensors = rows(sensors.collect()),
        growth = rows(growth.collect()),
        effects = rows(effects.collect()),
        joints = model.joint_count(),
    )
}
