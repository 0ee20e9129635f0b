//! A function of MATLAB (and Octave) that evaluates the model.

use super::portable::{Portable, number, numbers, plain};

/// The text of the function's file, `NAME.m`.
pub fn matlab(model: &Portable, function: &str) -> String {
    let rows = |rows: Vec<String>, columns: usize| match rows.is_empty() {
        true => format!("zeros(0, {columns})"),
        false => format!("[ ...\n{}    ]", rows.iter().map(|row| format!("    {row}; ...\n")).collect::<String>()),
    };
    let transforms = model.transforms.iter().map(|one| format!("{}, {}", numbers(&one.values), one.moves));
    // MATLAB counts from 1.
    let growth = model.growth.iter().map(|one| {
        let (linear, square) = (number(one.linear), number(one.square));
        format!("{}, {}, {}, {linear}, {square}", one.transform + 1, one.symbol + 1, one.sensor + 1)
    });
    let effects = model.effects.iter().map(|one| {
        let values = numbers(&[one.harmonic, one.cosine, one.sine, one.ratio, one.step]);
        format!("{}, {}, {values}", one.joint + 1, one.from + 1)
    });
    let references: Vec<f64> = model.sensors.iter().map(|(_, celsius)| *celsius).collect();
    let names: Vec<String> = model.sensors.iter().map(|(name, _)| plain(name)).collect();
    format!(
        r#"function place = {function}(q, celsius, approach)
% {name}: forward kinematics of its thermokin model. Metres, radians, degrees Celsius.
% place is the flange in the world (the frame of the tracker that the arm was calibrated with) as a 4 x 4 matrix.
% celsius: temperatures in the order {names}; left out or empty: the reference.
% approach: the sign of each joint's last motion, -1, 0 or 1; left out or empty: unknown.
    % d, theta, a, alpha, b, beta of Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta); the joint adds to 1: theta, 2: d.
    transforms = {transforms};
    reference = [{references}];
    % transform, place in its values, sensor, per K, per K^2
    growth = {growth};
    % joint, joint that it follows, harmonic, cosine, sine, ratio, step
    effects = {effects};
    if numel(q) ~= {joints}
        error('expected {joints} joints');
    end
    if nargin < 2 || isempty(celsius)
        celsius = reference;
    end
    if numel(celsius) ~= numel(reference)
        error('expected %d temperatures', numel(reference));
    end
    if nargin < 3 || isempty(approach)
        approach = zeros(1, {joints});
    end
    for n = 1:size(growth, 1)
        g = growth(n, :);
        rise = celsius(g(3)) - reference(g(3));
        transforms(g(1), g(2)) = transforms(g(1), g(2)) + g(4) * rise + g(5) * rise ^ 2;
    end
    stands = q(:);
    for n = 1:size(effects, 1)
        e = effects(n, :);
        from = q(e(2));
        stands(e(1)) = stands(e(1)) + e(4) * cos(e(3) * from) + e(5) * sin(e(3) * from) + e(6) * from ...
            + e(7) * approach(e(1));
    end
    place = eye(4);
    joint = 0;
    for n = 1:size(transforms, 1)
        t = transforms(n, :);
        if t(7) > 0
            joint = joint + 1;
            if t(7) == 1
                t(2) = t(2) + stands(joint);
            else
                t(1) = t(1) + stands(joint);
            end
        end
        place = place * move(3, t(1)) * turn(3, t(2)) * move(1, t(3)) * turn(1, t(4)) * move(2, t(5)) * turn(2, t(6));
    end
end

function m = move(axis, along)
    m = eye(4);
    m(axis, 4) = along;
end

function m = turn(axis, angle)
    m = eye(4);
    i = mod(axis, 3) + 1;
    j = mod(axis + 1, 3) + 1;
    m(i, i) = cos(angle);
    m(i, j) = -sin(angle);
    m(j, i) = sin(angle);
    m(j, j) = cos(angle);
end
"#,
        name = plain(&model.name),
        names = names.join(", "),
        transforms = rows(transforms.collect(), 7),
        references = numbers(&references),
        growth = rows(growth.collect(), 5),
        effects = rows(effects.collect(), 7),
        joints = model.joint_count(),
    )
}
