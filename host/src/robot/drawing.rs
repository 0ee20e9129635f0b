//! The arm as a drawing (SVG), so that a person sees a wrong sign: where it stands with all joints at zero, which way each
//! joint turns, and where it goes when one joint alone moves by a positive step.

use std::fmt::Write as _;

use nalgebra::Vector3;

use super::chain::Posture;
use super::description::{JointKind, Robot};
use super::frame::{Frame, centre_lines};

/// A view: where x and y of the paper lie in the world.
struct View {
    title: &'static str,
    right: Vector3<f64>,
    up: Vector3<f64>,
}

/// By how much a joint moves in its own panel.
const STEP_RAD: f64 = 0.5;
const STEP_M: f64 = 0.1;

/// The side of a panel, and its margin.
const PANEL: f64 = 260.0;
const MARGIN: f64 = 34.0;
const IN_A_ROW: usize = 3;

/// The arm's centre lines with joints at given positions, and the frames along them.
fn points(robot: &Robot, joints: &[f64]) -> (Vec<Vector3<f64>>, Vec<Frame>) {
    let frames = robot.chain().prepare(&robot.nominal()).frames(&Posture::new(joints));
    (centre_lines(&frames), frames)
}

/// The drawing of a robot as it is described, its first transform left out: the base stands upright.
pub fn drawing(robot: &Robot) -> String {
    let mut robot = robot.clone();
    if let Some(base) = robot.transforms.first_mut() {
        base.values.fill(0.0);
    }
    let third = 1.0 / 3_f64.sqrt();
    let slanted = || View {
        title: "",
        right: Vector3::new(-0.5_f64.sqrt(), 0.5_f64.sqrt(), 0.0),
        up: Vector3::new(-0.5 * third, -0.5 * third, 0.91),
    };
    let views = [
        View { title: "from the side: x right, z up", right: Vector3::x(), up: Vector3::z() },
        View { title: "from the front: y right, z up", right: Vector3::y(), up: Vector3::z() },
        View { title: "from above: x right, y up", right: Vector3::x(), up: Vector3::y() },
    ];
    let zero = vec![0.0; robot.joint_count()];
    let (rest, frames) = points(&robot, &zero);
    let reach = rest.iter().chain([&Vector3::zeros()]).map(|point| point.norm()).fold(0.1, f64::max);
    let kinds: Vec<JointKind> =
        robot.transforms.iter().filter_map(|transform| Some(transform.joint.as_ref()?.kind)).collect();
    let rows = 1 + kinds.len().div_ceil(IN_A_ROW);
    let (width, height) = (PANEL * IN_A_ROW as f64, PANEL * rows as f64);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (place, view) in views.iter().enumerate() {
        let mut panel = Panel { svg: &mut svg, view, place, scale: (0.5 * PANEL - MARGIN) / reach };
        panel.title(view.title);
        panel.arm(&rest, "#333333");
        let joints = robot.transforms.iter().enumerate().filter(|(_, transform)| transform.joint.is_some());
        for (joint, (number, _)) in joints.enumerate() {
            let Some(before) = number.checked_sub(1).and_then(|place| frames.get(place)) else { continue };
            panel.axis(before, joint + 1, 0.18 * reach);
        }
    }
    for (joint, kind) in kinds.iter().enumerate() {
        let mut moved = zero.clone();
        moved[joint] = if *kind == JointKind::Revolute { STEP_RAD } else { STEP_M };
        let (there, _) = points(&robot, &moved);
        let view = slanted();
        let place = IN_A_ROW + joint;
        let mut panel = Panel { svg: &mut svg, view: &view, place, scale: (0.5 * PANEL - MARGIN) / reach };
        panel.title(&match kind {
            JointKind::Revolute => format!("joint {} at +{STEP_RAD} rad", joint + 1),
            JointKind::Prismatic => format!("joint {} at +{STEP_M} m", joint + 1),
        });
        panel.arm(&rest, "#bbbbbb");
        panel.arm(&there, "#c0392b");
        panel.world(0.3 * reach);
    }
    svg.push_str("</svg>\n");
    svg
}

/// One panel of the drawing. Writing to a text does not fail, so what it returns says nothing.
struct Panel<'a> {
    svg: &'a mut String,
    view: &'a View,
    place: usize,
    scale: f64,
}

impl Panel<'_> {
    fn on_paper(&self, point: &Vector3<f64>) -> (f64, f64) {
        let (column, row) = ((self.place % IN_A_ROW) as f64, (self.place / IN_A_ROW) as f64);
        let middle = (PANEL * (column + 0.5), PANEL * (row + 0.62));
        (middle.0 + self.scale * self.view.right.dot(point), middle.1 - self.scale * self.view.up.dot(point))
    }

    fn title(&mut self, text: &str) {
        let (column, row) = ((self.place % IN_A_ROW) as f64, (self.place / IN_A_ROW) as f64);
        let _ = writeln!(self.svg, "<text x=\"{}\" y=\"{}\">{text}</text>", PANEL * column + 10.0, PANEL * row + 18.0);
    }

    fn arm(&mut self, points: &[Vector3<f64>], colour: &str) {
        let line: Vec<String> = points
            .iter()
            .map(|point| {
                let (x, y) = self.on_paper(point);
                format!("{x:.1},{y:.1}")
            })
            .collect();
        let _ = writeln!(
            self.svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"3\" stroke-linejoin=\"round\"/>",
            line.join(" ")
        );
        if let Some((x, y)) = points.last().map(|point| self.on_paper(point)) {
            let _ = writeln!(self.svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{colour}\"/>");
        }
    }

    /// An arrow along a joint's axis: the joint turns anticlockwise as seen from its tip.
    fn axis(&mut self, frame: &Frame, number: usize, length: f64) {
        let tip = frame.point(&Vector3::new(0.0, 0.0, length));
        self.arrow(&frame.origin, &tip, &number.to_string(), "#2060b0");
    }

    fn world(&mut self, length: f64) {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            self.arrow(&Vector3::zeros(), &Vector3::ith(axis, length), name, "#888888");
        }
    }

    fn arrow(&mut self, from: &Vector3<f64>, to: &Vector3<f64>, name: &str, colour: &str) {
        let ((x0, y0), (x1, y1)) = (self.on_paper(from), self.on_paper(to));
        let (dx, dy) = (x1 - x0, y1 - y0);
        let length = libm::hypot(dx, dy);
        if length < 3.0 {
            // Towards whoever looks, a dot; away, a cross.
            let towards = self.view.right.cross(&self.view.up).dot(&(to - from)) > 0.0;
            let sign = if towards { "⊙" } else { "⊗" };
            let _ = writeln!(
                self.svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" fill=\"{colour}\">{sign}{name}</text>",
                x0 + 4.0,
                y0 - 4.0
            );
            return;
        }
        let (ux, uy) = (dx / length, dy / length);
        let _ = writeln!(
            self.svg,
            "<path d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}M{:.1} {:.1}L{x1:.1} {y1:.1}L{:.1} {:.1}\" fill=\"none\" \
             stroke=\"{colour}\"/><text x=\"{:.1}\" y=\"{:.1}\" fill=\"{colour}\">{name}</text>",
            x1 - 6.0 * ux + 3.0 * uy,
            y1 - 6.0 * uy - 3.0 * ux,
            x1 - 6.0 * ux - 3.0 * uy,
            y1 - 6.0 * uy + 3.0 * ux,
            x1 + 6.0 * ux,
            y1 + 6.0 * uy + 4.0
        );
    }
}
