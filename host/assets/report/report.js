// Draws the page's figures: unpacks the library, gives the figures the colours of the scheme, follows a change of scheme,
// and draws for paper when the page is printed.
(async () => {
  "use strict";
  const read = (id) => document.getElementById(id).textContent;
  const series = { light: ["#0072b2", "#d55e00", "#00795a", "#a83279", "#946c00", "#6a51a3", "#2b6fb5", "#5b6470", "#8c3b1f"],
    dark: ["#56b4e9", "#ff8f45", "#3fc9a0", "#e58fc4", "#e8c547", "#b8a2e8", "#8fb8ff", "#aab4bf", "#d9926f"] };
  const schemes = {
    light: { page: "#ffffff", text: "#1b1f24", muted: "#545d68", line: "#d9dfe5", nominal: "#6b7480", geometric: "#0b5cb8", thermal: "#c2410c", extended: "#157a3c" },
    dark: { page: "#12161b", text: "#e6eaee", muted: "#a3adb8", line: "#36404b", nominal: "#9aa5b1", geometric: "#6cb2ff", thermal: "#ff9a57", extended: "#5fd38d" },
  };
  const painted = (value, scheme) => {
    if (Array.isArray(value)) return value.map((each) => painted(each, scheme));
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(([key, each]) => [key, painted(each, scheme)]));
    }
    if (typeof value !== "string" || value[0] !== "@") return value;
    const name = value.slice(1);
    return name.startsWith("series") ? series[scheme][Number(name.slice(6))] : schemes[scheme][name] ?? value;
  };
  const axisStyle = (colors) => ({ gridcolor: colors.line, zerolinecolor: colors.line, linecolor: colors.muted, ticks: "outside",
    tickcolor: colors.line, automargin: true });
  const laidOut = (figure, scheme, paperWidth) => {
    const colors = schemes[scheme];
    const layout = painted(figure.layout, scheme);
    for (const key of Object.keys(layout).filter((key) => /^[xy]axis/.test(key))) {
      layout[key] = { ...axisStyle(colors), ...layout[key], title: { standoff: 8, ...layout[key].title } };
    }
    if (layout.scene) {
      for (const key of ["xaxis", "yaxis", "zaxis"]) {
        layout.scene[key] = { ...layout.scene[key], gridcolor: colors.line, zerolinecolor: colors.line, showbackground: false, color: colors.text };
      }
      layout.uirevision = "kept";
    }
    const size = paperWidth ? { width: paperWidth, autosize: false } : { autosize: true };
    return { ...layout, ...size, height: paperWidth ? 0.78 * figure.height : figure.height, paper_bgcolor: colors.page, plot_bgcolor: colors.page,
      font: { family: 'system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif', size: 13, color: colors.text },
      margin: { l: 66, r: 12, t: 30, b: 52 }, hovermode: "closest", barmode: "group", showlegend: layout.showlegend ?? true };
  };
  const figures = JSON.parse(read("figures"));
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const current = () => (dark.matches ? "dark" : "light");
  const options = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d", "sendDataToCloud"] };
  const draw = (figure, scheme, paperWidth) => Plotly.react(figure.id, painted(figure.data, scheme),
    laidOut(figure, scheme, paperWidth), options);

  const packed = Uint8Array.from(atob(read("library").trim()), (letter) => letter.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(unpacked).text();
  document.head.append(script);
  const show = async (figure) => {
    const place = document.getElementById(figure.id);
    if (!place.dataset.shown) place.textContent = "";
    place.dataset.shown = "yes";
    await draw(figure, current());
    // What a screen reader is told of the drawing stands at the place; the letters at the ticks would only be noise.
    place.querySelectorAll("svg.main-svg").forEach((svg) => svg.setAttribute("aria-hidden", "true"));
  };
  const inSpace = (figure) => "scene" in figure.layout;
  figures.filter(inSpace).forEach((figure) => { document.getElementById(figure.id).textContent = "Drawn when it comes into sight."; });
  for (const figure of figures.filter((figure) => !inSpace(figure))) {
    await show(figure);
    await new Promise((done) => setTimeout(done));
    document.documentElement.dataset.opened ??= performance.now();
  }
  // One in space is drawn when somebody comes near it: on a machine without graphics it takes seconds, in which the page
  // would not answer.
  const near = new IntersectionObserver((seen) => {
    for (const { target } of seen.filter((entry) => entry.isIntersecting)) {
      near.unobserve(target);
      show(figures.find((figure) => figure.id === target.id));
    }
  }, { rootMargin: "200px" });
  figures.filter(inSpace).forEach((figure) => near.observe(document.getElementById(figure.id)));
  const shown = (figure) => document.getElementById(figure.id).dataset.shown;
  dark.addEventListener("change", () => figures.filter(shown).forEach((figure) => draw(figure, current())));
  addEventListener("beforeprint", () => figures.forEach((figure) => {
    if (!shown(figure)) show(figure);
    draw(figure, "light", 680);
  }));
  addEventListener("afterprint", () => figures.forEach((figure) => draw(figure, current())));
  document.documentElement.dataset.drawn = figures.length;
})().catch((error) => {
  document.querySelectorAll(".waiting").forEach((place) => { place.textContent = `The plot cannot be drawn: ${error.message}`; });
  throw error;
});
