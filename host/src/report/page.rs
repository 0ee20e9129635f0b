//! The page: chapters in their order, style, data, and the library that draws, all in one file.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;

use super::figure::Figure;
use super::table::escaped;
use super::{
    Contents, findings, left, observability, overview, parameters, provenance, quality, residuals, time, verdict,
};

/// plotly.js with the traces that the page uses, compressed by gzip; see host/assets/plotly/README.md.
const LIBRARY: &[u8] = include_bytes!("../../assets/plotly/plotly.min.js.gz");
/// Its licence, which travels with it.
const LIBRARY_LICENCE: &str = include_str!("../../assets/plotly/LICENSE");
const STYLE: &str = include_str!("../../assets/report/report.css");
const SCRIPT: &str = include_str!("../../assets/report/report.js");

/// The chapters: name within the page, title.
const CHAPTERS: [(&str, &str); 10] = [
    ("verdict", "Verdict"),
    ("drift", "Errors and temperatures over time"),
    ("poses", "Errors by pose"),
    ("thermal", "Thermal parameters over the run"),
    ("residuals", "Residual vectors"),
    ("parameters", "Parameters"),
    ("coefficients", "Thermal coefficients"),
    ("findings", "What was discovered"),
    ("observability", "Observability"),
    ("quality", "Data quality"),
];
/// The last one.
const REPRODUCE: (&str, &str) = ("reproduce", "How to reproduce it");

/// The whole page.
pub fn page(contents: &Contents<'_>) -> String {
    let results = contents.results;
    let mut plots = Plots::default();
    let mut bodies = vec![verdict::chapter(results)];
    let own = &results["on_run"];
    let other = &results["held_out"];

    let mut drift = plots.add(Some(time::over_time("errors-by-time", "on this run", &contents.own, own)), "");
    let mut poses = plots.add(Some(time::by_pose("errors-by-pose", "on this run", own)), "");
    if let Some(tried) = &contents.other {
        drift += &plots.add(Some(time::over_time("errors-by-time-held-out", "on data not seen", tried, other)), "");
        poses += &plots.add(Some(time::by_pose("errors-by-pose-held-out", "on data not seen", other)), "");
    }
    bodies.push(drift);
    bodies.push(poses);
    let predicted = contents
        .calibration
        .filter(|_| !contents.model.growth.is_empty())
        .and_then(|calibration| time::identified_and_predicted(&contents.own, contents.model, calibration));
    let why = "<p>There is nothing to compare: the model has no thermal coefficients, or the cycles of this run have too few \
               poses to be calibrated alone.</p>";
    bodies.push(plots.add(predicted, why));
    bodies.push(plots.add(Some(residuals::in_space(&contents.own, contents.model, own)), ""));
    bodies.push(parameters::parameter_chapter(results));
    bodies.push(parameters::coefficient_chapter(results));
    let evidence: Vec<String> = match contents.discovery {
        Some(discovery) => (0..discovery.findings.len())
            .map(|number| plots.add(findings::evidence(&contents.own, discovery, number), ""))
            .collect(),
        None => Vec::new(),
    };
    let mut left = String::new();
    if let Some(discovery) = contents.discovery {
        let nameless = findings::nameless(discovery).into_iter();
        for figure in nameless.chain(left::figures(&contents.own, discovery)) {
            left += &plots.add(Some(figure), "");
        }
    }
    bodies.push(findings::chapter(results, |number| evidence.get(number).cloned().unwrap_or_default(), &left));
    let mut observed = plots.add(observability::figure(results), "");
    observed += &observability::chapter(results);
    bodies.push(observed);
    bodies.push(quality::chapter(results));

    let chapters = CHAPTERS.into_iter().zip(bodies).chain([(REPRODUCE, provenance::chapter(results))]);
    let mut links = String::new();
    let mut body = String::new();
    for ((name, title), content) in chapters {
        links += &format!("<li><a href=\"#{name}\">{title}</a></li>");
        body += &format!(
            "<section id=\"{name}\" aria-labelledby=\"{name}-title\"><h2 id=\"{name}-title\">{title}</h2>{content}</section>\n"
        );
    }
    let title = format!("Calibration of {}", results["robot"].as_str().unwrap_or("an arm"));
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src 'unsafe-inline' \
         'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title} · thermokin</title>\n<style>{STYLE}</style>\n\
         </head>\n<body>\n<a class=\"skip\" href=\"#verdict\">Skip to the verdict</a>\n<header><h1>{title}</h1><p>{line}</p>\
         </header>\n<nav aria-label=\"Chapters\"><ol>{links}</ol></nav>\n<main>\n{body}</main>\n\
         <footer><p>Made by thermokin {version}. Nothing on this page comes from a network.</p></footer>\n\
         <script type=\"application/json\" id=\"results\">{results}</script>\n\
         <script type=\"application/json\" id=\"figures\">{figures}</script>\n\
         <!-- The charting library inside, compressed:\n{licence}\n-->\n\
         <script type=\"text/plain\" id=\"library\">{library}</script>\n<script>{SCRIPT}</script>\n</body>\n</html>\n",
        title = escaped(&title),
        line = overview::line(results),
        version = env!("CARGO_PKG_VERSION"),
        results = embedded(results),
        figures = embedded(&plots.figures.iter().map(Figure::to_json).collect()),
        licence = LIBRARY_LICENCE.replace("--", "- -"),
        library = STANDARD.encode(LIBRARY),
    )
}

/// JSON that may stand inside a script element: nothing in it can end the element.
fn embedded(value: &Value) -> String {
    value.to_string().replace('<', "\\u003c")
}

/// The plots of a page as they are put into its chapters.
#[derive(Default)]
struct Plots {
    figures: Vec<Figure>,
}

impl Plots {
    /// The place of a plot in its chapter; `absent` where there is none.
    fn add(&mut self, figure: Option<Figure>, absent: &str) -> String {
        let Some(figure) = figure else { return absent.to_owned() };
        let html = format!(
            "<figure><h3 id=\"{id}-title\">{title}</h3><div class=\"plot\" id=\"{id}\" role=\"group\" aria-label=\"{alt}\" \
             data-points=\"{points}\" style=\"height:{height}px\"><p class=\"waiting\">The plot needs JavaScript.</p></div>\
             <figcaption>{caption}</figcaption></figure>",
            id = escaped(&figure.id),
            title = escaped(&figure.title),
            alt = escaped(&figure.alt),
            caption = escaped(&figure.caption),
            points = figure.points(),
            height = figure.height,
        );
        self.figures.push(figure);
        html
    }
}
