"use strict";
// Trial by trial: filters the scatter's points and shows the trial behind one. All data is packed in the page.
(async () => {
  const block = document.getElementById("trials-data");
  const plot = document.querySelector(".points");
  if (!block || !plot || !("DecompressionStream" in window)) return;
  const bytes = Uint8Array.from(atob(block.textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const data = JSON.parse(await new Response(stream).text());
  document.documentElement.classList.add("scripted");

  const SVG = "http://www.w3.org/2000/svg";
  const ROBOTS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222", "#767676"];
  const ROOMS = ["#dcebf2", "#ece4f1", "#f8ead6", "#e4eedd"];
  const [size, left, bottom, pad] = data.plot;
  const [main] = data.compared;
  const form = document.querySelector(".filters");
  const dots = plot.querySelector(".dots");
  const panel = document.querySelector(".trial");
  plot.setAttribute("role", "group");  // its points are buttons
  let chosen = -1;

  const make = (parent, name, attributes = {}, text = "") => {
    const node = parent.appendChild(document.createElementNS(parent.namespaceURI, name));
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text) node.textContent = text;
    return node;
  };
  const svg = (parent, attributes) => {
    const node = parent.appendChild(document.createElementNS(SVG, "svg"));
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    return node;
  };
  const placed = (cost, upright) => {
    const share = cost / data.top, span = size - pad - (upright ? bottom : left);
    return (upright ? size - bottom - share * span : left + share * span).toFixed(1);
  };

  const shown = () => {
    const wanted = { class: form.class.value, robots: form.robots.value, template: form.template.value };
    return data.trials.map((trial, index) => [trial, index]).filter(([trial]) =>
      Object.entries(wanted).every(([key, value]) => value === "" || trial[key] === Number(value)));
  };

  // The chosen point keeps its mark whatever is drawn anew. Tab leads to it, or else to the first.
  const mark = (focused = null) => {
    for (const dot of dots.children) {
      dot.classList.toggle("chosen", Number(dot.dataset.trial) === chosen);
      dot.setAttribute("tabindex", -1);
    }
    (focused ?? dots.querySelector(".chosen") ?? dots.firstElementChild)?.setAttribute("tabindex", 0);
  };

  const draw = () => {
    const other = Number(form.other.value);
    dots.replaceChildren();
    let count = 0;
    for (const [trial, index] of shown()) {
      const own = trial.cost[main], theirs = trial.cost[other];
      if (own === null || theirs === null || theirs === undefined) continue;
      const dot = make(dots, "circle", { cx: placed(theirs, false), cy: placed(own, true), r: 3.6,
        class: `team-${trial.robots}`, "data-trial": index, tabindex: -1, role: "button" });
      make(dot, "title", {}, `${trial.id}: ${own.toFixed(0)} against ${theirs.toFixed(0)} cells`);
      count += 1;
    }
    mark();
    plot.querySelector(".x-name").textContent = `${data.planners[other]} (cells)`;
    form.querySelector(".shown").textContent = `${count} trial${count === 1 ? "" : "s"}`;
  };

  const map = (parent, trial, planner) => {
    const home = data.homes[trial.home], paths = trial.paths[planner];
    if (!home || !paths) return;
    const box = make(parent, "figure");
    make(box, "figcaption", {}, data.planners[planner]);
    const picture = svg(box, { viewBox: `0 0 ${home.size[0]} ${home.size[1]}`, class: "small-map", role: "img",
      "aria-label": `${trial.id}: where the robots drove with ${data.planners[planner]}` });
    for (const [room, points] of home.rooms) make(picture, "polygon", { points, fill: ROOMS[room] ?? "#eeeeee", stroke: "#3b3f45", "stroke-width": 6 });
    for (const points of home.doors) make(picture, "polyline", { points, class: "door", fill: "none", stroke: "#eeeeee", "stroke-width": 10 });
    for (const points of home.ways_out) make(picture, "polyline", { points, class: "way-out", fill: "none", stroke: "#ffffff", "stroke-width": 9, "stroke-dasharray": 9 });
    for (const [name, points] of home.containers) {
      make(make(picture, "polygon", { points, fill: "#ffffff", stroke: "#a39d94", "stroke-width": 2 }), "title", {}, name);
    }
    paths.forEach((line, robot) => {
      make(picture, "polyline", { points: line.join(" "), fill: "none", stroke: ROBOTS[robot % ROBOTS.length],
        "stroke-width": 9, "stroke-linejoin": "round", "stroke-linecap": "round", opacity: 0.8 });
      make(picture, "circle", { cx: line[line.length - 2], cy: line[line.length - 1], r: 20, fill: ROBOTS[robot % ROBOTS.length] });
    });
    const start = paths[0];
    if (start) make(picture, "circle", { cx: start[0], cy: start[1], r: 16, fill: "#222222" });
  };

  const show = (index) => {
    const trial = data.trials[index];
    chosen = index;
    mark();
    panel.replaceChildren();
    make(panel, "h3", {}, trial.id);
    if (trial.task) make(panel, "p", { class: "task" }, trial.task);
    if (trial.formula) make(make(panel, "p"), "code", {}, trial.formula);
    const about = [data.classes[trial.class], `${trial.robots} robot${trial.robots === 1 ? "" : "s"}`];
    if (trial.template >= 0) about.push(data.templates[trial.template]);
    make(panel, "p", { class: "note" }, about.join(", "));
    const maps = make(panel, "div", { class: "maps" });
    for (const planner of Object.keys(trial.paths)) map(maps, trial, planner);
    const rows = make(make(panel, "table"), "tbody");
    data.planners.forEach((name, planner) => {
      const row = make(rows, "tr");
      make(row, "th", {}, name);
      const cost = trial.cost[planner];
      make(row, "td", {}, cost === null ? trial.status[planner] : `${cost.toFixed(1)} cells`);
    });
    const command = make(panel, "p");
    make(command, "code", { class: "command" }, `python -m pipeline.replay trial_id=${trial.id}` + (block.dataset.output ? ` output_dir=${block.dataset.output}` : ""));
    if (data.replays.includes(trial.id)) make(make(panel, "p"), "a", { href: `replays/${trial.id}.html` }, "watch its replay");
  };

  dots.addEventListener("click", (event) => {
    const dot = event.target.closest("[data-trial]");
    if (dot) show(Number(dot.dataset.trial));
  });
  const STEPS = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 };
  dots.addEventListener("keydown", (event) => {
    const dot = event.target.closest("[data-trial]");
    if (!dot || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Enter" || event.key === " ") {
      show(Number(dot.dataset.trial));
    } else if (event.key in STEPS) {
      const across = [...dots.children].sort((one, other) => one.getAttribute("cx") - other.getAttribute("cx"));
      const next = across[across.indexOf(dot) + STEPS[event.key]] ?? dot;
      mark(next);
      next.focus();
    } else return;
    event.preventDefault();
  });
  form.addEventListener("change", draw);
  form.addEventListener("submit", (event) => event.preventDefault());
  draw();
})();
