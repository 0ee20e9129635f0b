use std::path::{Path, PathBuf};

fn shared() -> Option<PathBuf> {
    let shared = std::env::var_os("THERMOKIN_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    shared.join("data").is_dir().then_some(shared)
}

#[test]
fn reads_the_measured_sets() {
    let Some(shared) = shared() else {
        eprintln!("skipped: no ../shared/data here (set THERMOKIN_SHARED)");
        return;
    };
    for (name, visits, points, targets) in [
        ("irb120", 700, 4191, &["SMR1", "SMR2", "SMR3", "BASE1", "BASE2", "BASE3"][..]),
        ("ur10-a", 11911, 11911, &["TMAC"]),
        ("tx2-cal", 40, 40, &["TMAC"]),
        ("tx2-points", 300, 300, &["TMAC"]),
        ("blind-examples/example1", 360, 1437, &["T1", "T2", "T3", "T4"]),
    ] {
        let run = super::read(&shared.join("data").join(name)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(run.visits.len(), visits, "{name}");
        assert_eq!(run.point_count(), points, "{name}");
        assert_eq!(run.target_names, targets, "{name}");
        let notes = match name {
            "irb120" => &["points.csv: 9 broken beams (empty x_m, y_m, z_m)"][..],
            "blind-examples/example1" => &["points.csv: 3 broken beams (empty x_m, y_m, z_m)"],
            _ => &[],
        };
        assert_eq!(run.notes, notes, "{name}");
    }
}
