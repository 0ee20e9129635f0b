// The live page: takes states as server-sent events, shows their numbers, and keeps two plots; what it holds is bounded.
(() => {
  "use strict";
  const at = (id) => document.getElementById(id);
  const settings = JSON.parse(at("settings").textContent);
  const token = new URLSearchParams(location.search).get("token");
  // As many rows as the logger keeps, and those of the half minute until the whole is fetched anew.
  const RECENT = 900, WHOLE = 1440 + 30;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const colors = () => (dark.matches
    ? ["#56b4e9", "#ff8f45", "#3fc9a0", "#e58fc4", "#e8c547", "#b8a2e8", "#8fb8ff", "#aab4bf", "#d9926f"]
    : ["#0072b2", "#d55e00", "#00795a", "#a83279", "#946c00", "#6a51a3", "#2b6fb5", "#5b6470", "#8c3b1f"]);
  const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const number = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));
  const clock = (us) => new Date(us / 1000).toLocaleTimeString("en-GB");
  // Text is only ever put in as text: names come from files and boards.
  const put = (place, text) => { if (place.textContent !== text) place.textContent = text; };
  const list = (place, lines) => {
    const text = lines.join("\n");
    if (place.dataset.text === text) return;
    place.dataset.text = text;
    place.replaceChildren(...lines.map((line) => { const item = document.createElement("li"); item.textContent = line; return item; }));
  };

  let posture = settings.posture;
  const address = (path) => {
    const query = new URLSearchParams();
    if (settings.joints) query.set("q", posture.join(","));
    if (token) query.set("token", token);
    const text = query.toString();
    return text ? `${path}?${text}` : path;
  };

  // Plots: columns as the server keeps them, the last quarter of an hour or the whole time.
  const hours = (plot, times) => {
    const [from, until] = [plot.scales.x.min, plot.scales.x.max];
    const parts = { hour: "2-digit", minute: "2-digit", ...(until - from < 600 ? { second: "2-digit" } : {}) };
    return times.map((time) => new Date(1000 * time).toLocaleTimeString("en-GB", parts));
  };
  const axes = (unit) => [
    { values: hours, space: 90, incrs: [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800, 86400], stroke: ink("--text"), grid: { stroke: ink("--line"), width: 1 }, ticks: { stroke: ink("--line") } },
    { stroke: ink("--text"), grid: { stroke: ink("--line"), width: 1 }, ticks: { stroke: ink("--line") }, label: unit, size: 64 },
  ];
  const moment = { label: "time", value: (_, time) => (time ? new Date(1000 * time).toLocaleTimeString("en-GB") : "–") };
  const width = (place) => Math.max(280, place.clientWidth);
  const empty = () => ({ times: [], columns: [], drift: [] });
  let names = [], links = new Map(), span = "recent", plot = null, driftPlot = null;
  let kept = { recent: empty(), whole: empty() };
  const dashes = [[], [8, 4], [2, 3], [10, 3, 2, 3]];
  // What a click does in a legend, a key does as well.
  const byKeys = (place) => place.querySelectorAll(".u-legend").forEach((legend) => {
    legend.setAttribute("role", "presentation");
    legend.querySelectorAll(".u-series + .u-series th").forEach((name) => {
      name.tabIndex = 0;
      name.setAttribute("role", "button");
      name.setAttribute("aria-label", `show or hide ${name.textContent}`);
      name.addEventListener("keydown", (event) => {
        if (event.key === "Enter" || event.key === " ") { event.preventDefault(); name.click(); }
      });
    });
  });
  const build = () => {
    plot?.destroy();
    driftPlot?.destroy();
    const seen = new Map();
    const series = names.map((label) => {
      // One colour a link, one pattern for each of its sensors.
      const link = links.get(label) ?? label;
      const own = seen.get(link) ?? { color: colors()[seen.size % 9], count: 0 };
      seen.set(link, own);
      return { label, stroke: own.color, width: 1.6, dash: dashes[own.count++ % dashes.length], points: { show: false },
        value: (_, value) => (value === null || value === undefined ? "–" : `${value.toFixed(2)} °C`) };
    });
    const { times, columns, drift } = kept[span];
    plot = new uPlot({ width: width(at("plot")), height: 380, axes: axes("°C"), series: [moment, ...series], cursor: { drag: { x: true, y: true } } },
      [times, ...columns], at("plot"));
    byKeys(at("plot"));
    if (settings.joints) {
      driftPlot = new uPlot({ width: width(at("drift-plot")), height: 180, axes: axes("µm"),
        series: [moment, { label: "drift", stroke: colors()[1], width: 2, points: { show: false }, value: (_, value) => number(value, 1) }] },
      [times, drift], at("drift-plot"));
      byKeys(at("drift-plot"));
    }
    count();
  };
  const there = (values) => values.reduce((sum, value) => sum + Number(value !== null && value !== undefined), 0);
  const count = () => {
    at("plot").dataset.points = kept[span].columns.reduce((sum, column) => sum + there(column), 0);
    at("drift-plot").dataset.points = there(kept[span].drift);
  };
  const draw = () => {
    const { times, columns, drift } = kept[span];
    plot?.setData([times, ...columns]);
    driftPlot?.setData([times, drift]);
    count();
  };
  const refresh = async () => {
    // A logger that has just ended does not answer; that is said elsewhere.
    const answer = await fetch(address("/history")).catch(() => null);
    if (!answer?.ok) return;
    const history = await answer.json();
    kept = { recent: history.recent, whole: history.whole };
    if (JSON.stringify(history.names) === JSON.stringify(names) && plot) { draw(); return; }
    names = history.names;
    build();
  };
  const add = ({ times, columns, drift }, most, state, length) => {
    const values = new Map(state.sensors.map((sensor) => [sensor.name, sensor.silent ? null : sensor.celsius]));
    times.push(state.time_s);
    names.forEach((name, place) => columns[place].push(values.get(name) ?? null));
    drift.push(length);
    for (const column of [times, ...columns, drift]) column.splice(0, Math.max(0, column.length - most));
  };

  // Tables.
  const cells = (row, texts) => {
    while (row.children.length < texts.length) row.append(document.createElement("td"));
    texts.forEach((text, place) => put(row.children[place], text));
  };
  const rows = (body, items, texts, old) => {
    while (body.children.length > items.length) body.lastChild.remove();
    while (body.children.length < items.length) body.append(document.createElement("tr"));
    items.forEach((item, place) => {
      const row = body.children[place];
      cells(row, texts(item));
      row.className = old(item) ? "old" : "";
    });
  };
  const lasting = (seconds) => `${Math.floor(seconds / 3600)} h ${String(Math.floor(seconds / 60) % 60).padStart(2, "0")} min ${String(Math.floor(seconds) % 60).padStart(2, "0")} s`;
  const reading = (sensor) => (sensor.celsius === null ? "not read yet" : sensor.silent ? "silent" : "read");

  // What is wrong, in plain words; none of them changes while it lasts, so that it is read out once.
  const wrong = (state) => {
    const lines = [...state.troubles];
    const named = (boards) => `${boards.length === 1 ? "Board" : "Boards"} ${boards.map((board) => board.board).join(", ")}`;
    const verb = (boards, one, many) => (boards.length === 1 ? one : many);
    const heard = state.boards.filter((board) => board.state !== "not heard yet");
    if (state.boards.length === 0) lines.push("The registry has no boards: `thermokin board add` puts them there.");
    else if (heard.length === 0) lines.push(`No board has been heard yet. The logger listens on ${state.listen} and waits for ${state.boards.length}.`);
    else {
      const missing = state.boards.filter((board) => board.state === "not heard yet");
      if (missing.length) lines.push(`${named(missing)} ${verb(missing, "has", "have")} not been heard yet.`);
    }
    const silent = heard.filter((board) => board.state === "silent");
    if (silent.length > 3) lines.push(`${named(silent)} are silent: the last of them was heard at ${clock(Math.max(...silent.map((board) => board.heard_us)))}.`);
    else for (const board of silent) lines.push(`Board ${board.board} is silent: last heard at ${clock(board.heard_us)}.`);
    const alive = new Set(heard.filter((board) => board.state === "heard").map((board) => board.board));
    const mute = state.sensors.filter((sensor) => sensor.silent && alive.has(sensor.board)).map((sensor) => sensor.name);
    if (mute.length) lines.push(`No readings from ${mute.join(", ")}, though ${verb(mute, "its board is", "their boards are")} heard.`);
    if (state.sensors_hidden) lines.push(`${state.sensors_hidden} more sensors are logged and not shown here.`);
    if (state.boards_hidden) lines.push(`${state.boards_hidden} more boards are known and not shown here.`);
    return lines;
  };

  let drawnAt = 0, refreshedAt = 0, states = 0;
  const show = async ({ state, drift: predicted }) => {
    put(at("link"), `Connected; logging into ${state.store}.`);
    at("link").className = "";
    const lines = wrong(state);
    list(at("alarms"), lines);
    document.title = lines.length ? "(!) thermokin · live" : "thermokin · live";
    put(at("run"), state.run ? `${state.run.name}, ${lasting(state.run.for_s)}` : "none");
    put(at("heard"), `${state.boards.filter((board) => board.state === "heard").length} of ${state.boards.length + state.boards_hidden}`);
    put(at("readings"), state.readings.toLocaleString("en"));
    put(at("lost"), state.lost.toLocaleString("en"));
    put(at("refused"), state.refused.toLocaleString("en"));
    put(at("free"), state.free === null ? "–" : `${(state.free / 1e9).toFixed(1)} GB`);
    const sensors = state.sensors.map((sensor, place) => ({ ...sensor, place }));
    sensors.sort((a, b) => (a.link ?? 1e9) - (b.link ?? 1e9) || a.place - b.place);
    rows(at("sensors"), sensors, (sensor) => [sensor.link === null ? "–" : `link ${sensor.link}`, sensor.name,
      number(sensor.celsius, 2), number(sensor.k_per_min, 2), number(sensor.age_s, 1), reading(sensor)], (sensor) => sensor.silent);
    rows(at("boards"), state.boards, (board) => [String(board.board), board.state, number(board.silent_s, 1), number(board.battery_mv, 0),
      number(board.signal_dbm, 0), number(board.clock_ms, 2), number(board.reads_failed, 0), number(board.lost, 0), board.reset ?? "–"],
    (board) => board.state === "silent");
    list(at("words"), state.words.map((word) => `${word.time} ${word.text}`));
    if (predicted) {
      put(at("drift-length"), number(predicted.length_um, 1));
      put(at("drift-axes"), predicted.um.map((value) => (value < 0 ? "" : "+") + number(value, 1)).join(", "));
      const words = [];
      if (predicted.missing.length) words.push(`Not read yet, taken as at the reference: ${predicted.missing.join(", ")}.`);
      if (predicted.old.length) words.push(`Silent, taken as read last: ${predicted.old.join(", ")}.`);
      for (const note of settings.notes) words.push(`Of the model, ${note}.`);
      put(at("drift-words"), words.join(" "));
      at("drift-words").hidden = words.length === 0;
    }
    const strangers = state.sensors.some((sensor) => !names.includes(sensor.name));
    if (refreshedAt === 0 || (strangers && state.time_s - refreshedAt > 1) || (span === "whole" && state.time_s - refreshedAt > 30)) {
      refreshedAt = state.time_s;
      links = new Map(state.sensors.map((sensor) => [sensor.name, sensor.link ?? `board ${sensor.board}`]));
      await refresh();
    }
    if (plot && state.time_s - (kept[span].times.at(-1) ?? 0) >= 0.9) {
      const known = predicted && predicted.missing.length === 0;
      const length = known ? predicted.length_um : null;
      add(kept.recent, RECENT, state, length);
      if (span === "whole") add(kept.whole, WHOLE, state, length);
    }
    if (!document.hidden && state.time_s - drawnAt >= 0.9) { drawnAt = state.time_s; draw(); }
    document.documentElement.dataset.states = ++states;
  };

  // States, one after the other; the browser itself asks again when the line breaks.
  let source = null, queue = Promise.resolve();
  const lost = (words) => { put(at("link"), words); at("link").className = "bad"; document.title = "(!) thermokin · live"; };
  const listen = () => {
    source?.close();
    refreshedAt = 0;
    const own = new EventSource(address("/events"));
    source = own;
    const then = (work) => { queue = queue.then(work).catch((error) => console.error(error)); };
    own.onmessage = (event) => then(() => (own === source ? show(JSON.parse(event.data)) : null));
    own.onerror = () => {
      refreshedAt = 0;
      then(() => { if (own === source && own.readyState !== EventSource.OPEN) lost("The logger does not answer; what stands here is old."); });
    };
    own.addEventListener("end", () => { own.close(); then(() => lost(`The logger has ended, at ${new Date().toLocaleTimeString("en-GB")}; what stands here is its last word.`)); });
  };

  if (settings.joints) {
    at("drift").hidden = false;
    const factor = (place) => (settings.joints[place] ? 180 / Math.PI : 1000);
    settings.joints.forEach((turns, place) => {
      const label = document.createElement("label");
      label.textContent = `joint ${place + 1}, ${turns ? "°" : "mm"}`;
      const input = document.createElement("input");
      input.type = "number"; input.step = "any"; input.required = true;
      input.value = String(Number((posture[place] * factor(place)).toFixed(3)));
      label.append(input);
      at("joints").append(label);
    });
    at("posture").addEventListener("submit", (event) => {
      event.preventDefault();
      posture = [...at("joints").querySelectorAll("input")].map((input, place) => Number(input.value) / factor(place));
      listen();
    });
  }
  document.querySelectorAll("[data-span]").forEach((button) => button.addEventListener("click", () => {
    span = button.dataset.span;
    document.querySelectorAll("[data-span]").forEach((other) => other.setAttribute("aria-pressed", String(other === button)));
    queue = queue.then(refresh).then(draw);
  }));
  dark.addEventListener("change", () => { if (plot) build(); });
  addEventListener("resize", () => { plot?.setSize({ width: width(at("plot")), height: 380 }); driftPlot?.setSize({ width: width(at("drift-plot")), height: 180 }); });
  listen();
})();
