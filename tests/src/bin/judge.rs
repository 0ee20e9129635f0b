//! `judge`: how often thermokin names what is hidden, beside how often the oracle does with the same data. One line a run, as CSV,
//! and a table by effect and signal-to-noise ratio.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use thermokin_tests::hidden::kind::Kind;
use thermokin_tests::hidden::naming::verdict;
use thermokin_tests::judged::{Hidden, Name};

/// Hides every effect several times, examines the runs, and counts right and wrong names.
///
/// Example: judge --rho 4,6,8,12 --runs 10 --csv host/docs/naming.csv
#[derive(Parser)]
struct Arguments {
    /// Seed of the first run; the others follow it.
    #[arg(long, default_value_t = 10_000)]
    seed: u64,
    /// Signal-to-noise ratios.
    #[arg(long, value_delimiter = ',', default_value = "4,6,8,12")]
    rho: Vec<f64>,
    /// Runs of each effect at each of them; as many again that hide nothing.
    #[arg(long, default_value_t = 5)]
    runs: u64,
    /// These effects alone; absent: all that positions show.
    #[arg(long, value_delimiter = ',')]
    effects: Vec<String>,
    /// Where the runs go.
    #[arg(long, default_value = "target/judged")]
    folder: PathBuf,
    /// The file with a line a run.
    #[arg(long)]
    csv: PathBuf,
}

/// Counts of one effect at one signal-to-noise ratio.
#[derive(Default)]
struct Count {
    runs: usize,
    right: usize,
    oracle: usize,
    wrong: usize,
    held: usize,
    intervals: usize,
}

const HEAD: &str =
    "seed,effect,rho,right,oracle_right,wrong_names,intervals_held,intervals,nearest_sine,hidden,named\n";

fn main() -> ExitCode {
    match judge(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("judge: {error}");
            ExitCode::from(2)
        }
    }
}

fn judge(arguments: &Arguments) -> Result<(), String> {
    let effects: Vec<String> = match arguments.effects.as_slice() {
        [] => Kind::CATALOGUE
            .into_iter()
            .filter(|kind| !kind.is_gross() && (!kind.is_of_readings() || *kind == Kind::ClockOffset))
            .map(|kind| kind.name().to_owned())
            .collect(),
        some => some.to_vec(),
    };
    let mut seed = arguments.seed;
    let mut csv = HEAD.to_owned();
    let mut counts: BTreeMap<(String, u64), Count> = BTreeMap::new();
    let mut one = |effect: Option<&str>, rho: f64| -> Result<(), String> {
        let hidden = Hidden::new(seed, effect.as_slice(), rho);
        let effect = effect.unwrap_or("none");
        let (line, run) = examined(&hidden, &arguments.folder, effect)?;
        csv.push_str(&line);
        write(&arguments.csv, &csv)?;
        let count = counts.entry((effect.to_owned(), (1e3 * rho) as u64)).or_default();
        count.runs += 1;
        count.right += run.right;
        count.oracle += run.oracle;
        count.wrong += run.wrong;
        count.held += run.held;
        count.intervals += run.intervals;
        seed += 1;
        Ok(())
    };
    for &rho in &arguments.rho {
        for effect in &effects {
            (0..arguments.runs).try_for_each(|_| one(Some(effect), rho))?;
        }
    }
    (0..arguments.runs * arguments.rho.len() as u64).try_for_each(|_| one(None, 0.0))?;
    println!("effect                   rho  runs  right  oracle  wrong names  intervals that hold");
    for ((effect, rho), Count { runs, right, oracle, wrong, held, intervals }) in &counts {
        let rho = *rho as f64 / 1e3;
        println!("{effect:22} {rho:5.1} {runs:5} {right:6} {oracle:7} {wrong:12}  {held} of {intervals}");
    }
    Ok(())
}

/// One run as a line of the file, and as counts.
fn examined(hidden: &Hidden, folder: &Path, effect: &str) -> Result<(String, Count), String> {
    let examined = hidden.examine(folder)?;
    let verdict = verdict(&examined.case);
    let arm = &examined.case.world.arm;
    let (truth, named) = (examined.hidden(), examined.named());
    let by_oracle: std::collections::BTreeSet<Name> =
        verdict.named.iter().map(|(kind, place)| (kind.answer().to_owned(), place.to_json(arm).to_string())).collect();
    let (held, intervals) = examined.intervals();
    let run = Count {
        runs: 1,
        right: usize::from(examined.is_right()),
        oracle: usize::from(by_oracle == truth),
        wrong: named.difference(&truth).filter(|(name, _)| name != "unexplained").count(),
        held,
        intervals,
    };
    let words = |names: &std::collections::BTreeSet<Name>| {
        let words: Vec<String> = names.iter().map(|(effect, place)| format!("{effect} {place}")).collect();
        format!("\"{}\"", words.join("; ").replace('"', "\"\""))
    };
    let nearest = verdict.nearest.first().and_then(|near| near.first()).map_or(1.0, |(.., sine)| *sine);
    let mut line = String::new();
    let _ = writeln!(
        line,
        "{},{effect},{},{},{},{},{held},{intervals},{nearest:.4},{},{}",
        hidden.seed,
        hidden.rho,
        run.right,
        run.oracle,
        run.wrong,
        words(&truth),
        words(&named)
    );
    Ok((line, run))
}

fn write(file: &Path, text: &str) -> Result<(), String> {
    std::fs::write(file, text).map_err(|error| format!("{}: {error}", file.display()))
}
