//! The report as a person sees it: opened in a browser, its plots counted, its numbers held against the JSON, its
//! accessibility checked, its size and the time to open it measured.

mod browser;

use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Output};

use browser::{Browser, LOOKS};
use serde_json::Value;

const DRAWN: &str = "document.documentElement?.dataset.drawn";

fn thermokin(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_thermokin")).args(arguments).output().expect("the binary")
}

fn done(arguments: &[&str]) {
    let output = thermokin(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path of letters")
}

/// The address of a file.
fn address(file: &Path) -> String {
    format!("file://{}", file.canonicalize().expect("it is there").display())
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("written")).expect("JSON")
}

/// For every plot: its name, the points that it says it has, the points of its data, the marks drawn and those to be drawn.
const PLOTS: &str = "Promise.all([...document.querySelectorAll('.plot')].map(async (plot) => {
    const there = (values) => Array.from(values ?? []).filter((value) => value !== null && value !== undefined).length;
    const points = plot.data.reduce((sum, trace) => sum + there(trace.y), 0);
    const marked = plot.data.filter((t) => t.visible !== 'legendonly' && (t.type === 'bar' || (t.type === 'scatter' && t.mode.includes('markers'))));
    const lines = plot.data.filter((t) => t.visible !== 'legendonly' && t.type === 'scatter' && t.mode.includes('lines')).length;
    let lit = -1;
    if (plot.querySelector('.gl-container canvas')) {
        const picture = new Image();
        picture.src = await Plotly.toImage(plot, { format: 'png', width: 600, height: 450 });
        await picture.decode();
        const copy = document.createElement('canvas');
        copy.width = 600; copy.height = 450;
        const context = copy.getContext('2d');
        context.drawImage(picture, 0, 0);
        const pixels = new Uint32Array(context.getImageData(0, 0, 600, 450).data.buffer);
        lit = pixels.filter((pixel) => pixel !== pixels[0]).length;
    }
    return { id: plot.id, said: Number(plot.dataset.points), points, lit, lines,
        wanted: marked.reduce((sum, t) => sum + there(t.y), 0),
        drawn: plot.querySelectorAll('.scatterlayer path.point, .barlayer .point path').length,
        drawnLines: [...plot.querySelectorAll('.scatterlayer path.js-line')].filter((p) => p.getAttribute('d')?.length > 8).length,
        words: plot.getAttribute('aria-label') ?? '' };
}))";

/// Every number and text that names its source.
const CELLS: &str = "[...document.querySelectorAll('[data-from]')].map((cell) => (
    { from: cell.dataset.from, factor: Number(cell.dataset.factor ?? 1), text: cell.textContent }))";

fn check_plots(browser: &mut Browser, least: usize) {
    // Those in space are drawn when they come into sight, not before.
    let waiting = "[...document.querySelectorAll('.plot:not(.js-plotly-plot)')].map((plot) => plot.id)";
    let waiting: Vec<String> = serde_json::from_value(browser.evaluate(waiting)).expect("names");
    assert!(waiting.contains(&"residual-vectors".to_owned()), "{waiting:?}");
    for id in waiting {
        browser.evaluate(&format!("document.getElementById('{id}').scrollIntoView(); 0"));
        browser.wait(&format!("document.querySelector('#{id} .gl-container canvas')"));
    }
    let plots = browser.evaluate(PLOTS);
    let plots = plots.as_array().expect("a list");
    assert!(plots.len() >= least, "{} plots", plots.len());
    for plot in plots {
        assert_eq!(plot["said"], plot["points"], "{plot}");
        assert!(plot["points"].as_u64() > Some(1), "{plot}");
        assert_eq!(plot["wanted"], plot["drawn"], "{plot}");
        assert_eq!(plot["lines"], plot["drawnLines"], "{plot}");
        assert!(plot["lit"] == -1 || plot["lit"].as_u64() > Some(2000), "the picture in space is empty: {plot}");
        assert!(plot["words"].as_str().is_some_and(|words| words.len() > 30), "{plot}");
    }
    assert!(plots.iter().any(|plot| plot["lit"] != -1), "no plot in space");
}

fn check_cells(browser: &mut Browser, results: &Value, least: usize) {
    let cells = browser.evaluate(CELLS);
    let cells = cells.as_array().expect("a list");
    assert!(cells.len() >= least, "{} cells", cells.len());
    for cell in cells {
        let (from, text) = (cell["from"].as_str().unwrap_or(""), cell["text"].as_str().unwrap_or(""));
        let value = results.pointer(from).unwrap_or_else(|| panic!("{from}: not in the JSON"));
        if let Some(words) = value.as_str() {
            assert_eq!(words, text, "{from}");
            continue;
        }
        let shown: f64 = text.parse().unwrap_or_else(|_| panic!("{from}: {text} is no number"));
        let own = value.as_f64().unwrap_or_else(|| panic!("{from}: {value}")) * cell["factor"].as_f64().unwrap_or(1.0);
        // Half of the last digit that is shown.
        let (digits, power) = text.split_once('e').unwrap_or((text, "0"));
        let decimals = digits.split_once('.').map_or(0, |(_, decimals)| decimals.len()) as i32;
        let unit = 10f64.powi(power.parse::<i32>().expect("a power") - decimals);
        assert!((shown - own).abs() <= 0.5001 * unit, "{from}: the page says {text}, the JSON {own}");
    }
}

fn check_access(browser: &mut Browser) {
    for (width, scheme) in LOOKS {
        browser.look(width, scheme);
        // Redrawing for another scheme is done when the plots have its colours.
        let paper = if scheme == "dark" { "rgb(18, 22, 27)" } else { "rgb(255, 255, 255)" };
        browser.wait(&format!(
            "[...document.querySelectorAll('.plot:not(:has(.gl-container canvas))')].every((p) => \
             getComputedStyle(p.querySelector('.main-svg')).backgroundColor === '{paper}')"
        ));
        let found = browser.axe();
        assert!(found.is_empty(), "{width} pixels, {scheme}:\n{}", found.join("\n"));
        browser.picture(&format!("report-{width}-{scheme}"));
    }
}

#[test]
fn the_report_shows_what_the_json_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let [run, model, page, results] = ["run", "model.json", "report.html", "report.json"].map(at);
    // The scenario's own seed; the discovery's is 1.
    println!("scenario small with its own seed, discovery seed 1");
    done(&["simulate", "small", "--out", text(&run)]);
    done(&["calibrate", text(&run), "--out", text(&model)]);
    done(&["report", text(&run), text(&model), "--out", text(&page), "--json", text(&results)]);
    let results = json(&results);
    let mut browser = Browser::start();
    browser.look(1280, "light");
    browser.open(&address(&page), DRAWN);
    check_plots(&mut browser, 5);
    check_cells(&mut browser, &results, 150);
    let inside = browser.evaluate("document.getElementById('results').textContent");
    let inside: Value = serde_json::from_str(inside.as_str().unwrap_or("")).expect("JSON");
    assert_eq!(inside, results);
    let titles = browser.evaluate("[...document.querySelectorAll('main h2')].map((h) => h.textContent)");
    assert_eq!(titles.as_array().map(Vec::len), Some(11), "{titles}");
    let sentences = browser.evaluate("[...document.querySelectorAll('.verdict p')].map((p) => p.textContent)");
    assert_eq!(sentences, results["verdict"]);
    browser.press("Tab", 9);
    assert_eq!(browser.evaluate("document.activeElement.className"), "skip", "the first key goes to the verdict");
    check_access(&mut browser);
    assert_eq!(browser.errors(), Vec::<String>::new());
    let outside: Vec<String> = browser
        .asked_for()
        .into_iter()
        .filter(|url| !["file:", "data:", "blob:"].iter().any(|own| url.starts_with(own)))
        .collect();
    assert_eq!(outside, Vec::<String>::new(), "asked for from outside");
}

/// The example run ten times over, one series after the other: as long as the longest public one.
fn ten_times(source: &Path, run: &Path) {
    std::fs::create_dir_all(run).expect("a folder");
    for file in ["run.toml", "robot.toml"] {
        std::fs::copy(source.join(file), run.join(file)).expect("copied");
    }
    for file in ["poses.csv", "points.csv", "temperatures.csv"] {
        let read = std::fs::read_to_string(source.join(file)).expect("read");
        let (head, rows) = read.split_once('\n').expect("a head");
        let mut text = format!("{head}\n");
        for time in 0..10_u32 {
            for row in rows.lines() {
                let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
                cells[0] = format!("{}", cells[0].parse::<f64>().expect("a time") + 4e5 * f64::from(time));
                if file != "temperatures.csv" {
                    cells[2] = format!("{}", cells[2].parse::<u32>().expect("a pose") + 20_000 * time);
                }
                writeln!(text, "{}", cells.join(",")).expect("written");
            }
        }
        std::fs::write(run.join(file), text).expect("written");
    }
}

#[test]
fn the_report_of_the_largest_run_is_small_and_opens_at_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let [run, model, page] = ["run", "model.json", "report.html"].map(|name| folder.path().join(name));
    ten_times(&Path::new(env!("CARGO_MANIFEST_DIR")).join("data/ur10"), &run);
    done(&["calibrate", text(&run), "--poses", "every:10", "--out", text(&model)]);
    done(&["report", text(&run), text(&model), "--poses", "every:10", "--no-discover", "--out", text(&page)]);
    let bytes = std::fs::metadata(&page).expect("written").len();
    let mut browser = Browser::start();
    browser.look(1280, "light");
    // Others use the machine as well: the fastest of a few.
    let fastest = (0..4)
        .map(|_| {
            browser.open(&address(&page), DRAWN);
            browser.evaluate("Number(document.documentElement.dataset.opened)").as_f64().expect("milliseconds")
        })
        .fold(f64::INFINITY, f64::min);
    println!("{bytes} bytes; open after {fastest:.0} ms");
    check_plots(&mut browser, 4);
    assert!(bytes < 5_000_000, "{bytes} bytes");
    assert!(fastest < 2000.0, "open after {fastest} ms");
    assert_eq!(browser.errors(), Vec::<String>::new());
}

#[test]
fn what_cannot_be_reported_leaves_no_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let page = folder.path().join("report.html");
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/data/ur10");
    let robot = concat!(env!("CARGO_MANIFEST_DIR"), "/data/ur10/robot.toml");
    for (model, words) in [("no-model.json", "no-model.json: cannot be read"), (robot, "is no model file")] {
        let output = thermokin(&["report", example, model, "--out", text(&page)]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(words) && said.trim_end().lines().count() == 1, "{said}");
        assert!(!page.exists());
    }
}
