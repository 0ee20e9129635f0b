//! A header of C99 for controllers: one function without allocation, errors or anything but math.h.

use super::portable::{Portable, number, numbers, plain};

/// The text of the header.
pub fn c_header(model: &Portable) -> String {
    // C has no empty arrays: an entry that adds nothing stands for none.
    let rows = |rows: Vec<String>, none: &str| match rows.is_empty() {
        true => format!("    {none}\n"),
        false => rows.iter().map(|row| format!("    {row},\n")).collect::<String>(),
    };
    let transforms = model.transforms.iter().map(|one| format!("{{{{{}}}, {}}}", numbers(&one.values), one.moves));
    let growth = model.growth.iter().map(|one| {
        format!("{{{}, {}, {}, {}, {}}}", one.transform, one.symbol, one.sensor, number(one.linear), number(one.square))
    });
    let effects = model.effects.iter().map(|one| {
        let values = numbers(&[one.harmonic, one.cosine, one.sine, one.ratio, one.step]);
        format!("{{{}, {}, {values}}}", one.joint, one.from)
    });
    let references = model.sensors.iter().map(|(name, celsius)| format!("{}, /* {} */", number(*celsius), plain(name)));
    let references: String = match model.sensors.is_empty() {
        true => "    0.0\n".to_owned(),
        false => references.map(|row| format!("    {row}\n")).collect(),
    };
    format!(
        r#"/* {name}: forward kinematics of its thermokin model. Metres, radians, degrees Celsius.
 * The world is the frame of the tracker that the arm was calibrated with. C99, math.h alone. */
#ifndef THERMOKIN_MODEL_H
#define THERMOKIN_MODEL_H

#include <math.h>

#define THERMOKIN_JOINTS {joints}
#define THERMOKIN_TRANSFORMS {transform_count}
#define THERMOKIN_SENSORS {sensor_count}

/* Reference temperatures, in the order in which thermokin_forward takes temperatures. */
static const double thermokin_reference_c[] = {{
{references}}};

/* Tz(d) Rz(theta) Tx(a) Rx(alpha) Ty(b) Ry(beta); the joint adds to 1: theta, 2: d, 0: there is none. */
static const struct {{
    double values[6];
    int moves;
}} thermokin_transforms[] = {{
{transforms}}};

static const struct {{
    int transform, place, sensor;
    double per_k, per_k2;
}} thermokin_growth[] = {{
{growth}}};

static const struct {{
    int joint, from;
    double harmonic, cosine, sine, ratio, step;
}} thermokin_effects[] = {{
{effects}}};

/* m = m * rotation about an axis (0 x, 1 y, 2 z). */
static inline void thermokin_turn(double m[3][4], int axis, double angle)
{{
    const double c = cos(angle), s = sin(angle);
    const int i = (axis + 1) % 3, j = (axis + 2) % 3;
    for (int row = 0; row < 3; row++) {{
        const double u = m[row][i], v = m[row][j];
        m[row][i] = c * u + s * v;
        m[row][j] = c * v - s * u;
    }}
}}

/* m = m * translation along an axis. */
static inline void thermokin_move(double m[3][4], int axis, double length)
{{
    for (int row = 0; row < 3; row++)
        m[row][3] += length * m[row][axis];
}}

/* The flange in the world: rotation in the first three columns, origin in the fourth.
 * celsius: THERMOKIN_SENSORS temperatures, or NULL for the reference; approach: the sign of each joint's last motion
 * (-1, 0, 1), or NULL. */
static inline void thermokin_forward(const double q[THERMOKIN_JOINTS], const double *celsius, const double *approach,
                                     double place[3][4])
{{
    double values[THERMOKIN_TRANSFORMS][6], stands[THERMOKIN_JOINTS];
    for (int t = 0; t < THERMOKIN_TRANSFORMS; t++)
        for (int k = 0; k < 6; k++)
            values[t][k] = thermokin_transforms[t].values[k];
    if (celsius)
        for (unsigned n = 0; n < sizeof thermokin_growth / sizeof *thermokin_growth; n++) {{
            const int sensor = thermokin_growth[n].sensor;
            const double rise = celsius[sensor] - thermokin_reference_c[sensor];
            values[thermokin_growth[n].transform][thermokin_growth[n].place] +=
                thermokin_growth[n].per_k * rise + thermokin_growth[n].per_k2 * rise * rise;
        }}
    for (int n = 0; n < THERMOKIN_JOINTS; n++)
        stands[n] = q[n];
    for (unsigned n = 0; n < sizeof thermokin_effects / sizeof *thermokin_effects; n++) {{
        const double from = q[thermokin_effects[n].from];
        const int joint = thermokin_effects[n].joint;
        stands[joint] += thermokin_effects[n].cosine * cos(thermokin_effects[n].harmonic * from) +
                         thermokin_effects[n].sine * sin(thermokin_effects[n].harmonic * from) +
                         thermokin_effects[n].ratio * from +
                         thermokin_effects[n].step * (approach ? approach[joint] : 0.0);
    }}
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 4; column++)
            place[row][column] = row == column;
    for (int t = 0, joint = 0; t < THERMOKIN_TRANSFORMS; t++) {{
        const int moves = thermokin_transforms[t].moves;
        const double more = moves ? stands[joint++] : 0.0;
        thermokin_move(place, 2, values[t][0] + (moves == 2 ? more : 0.0));
        thermokin_turn(place, 2, values[t][1] + (moves == 1 ? more : 0.0));
        thermokin_move(place, 0, values[t][2]);
        thermokin_turn(place, 0, values[t][3]);
        thermokin_move(place, 1, values[t][4]);
        thermokin_turn(place, 1, values[t][5]);
    }}
}}

#endif
"#,
        name = plain(&model.name),
        joints = model.joint_count(),
        transform_count = model.transforms.len(),
        sensor_count = model.sensors.len(),
        transforms = rows(transforms.collect(), "{{0}, 0}"),
        growth = rows(growth.collect(), "{0, 0, 0, 0.0, 0.0}"),
        effects = rows(effects.collect(), "{0, 0, 0.0, 0.0, 0.0, 0.0, 0.0}"),
    )
}
