"use strict";
// Moves the replay's picture to a point in time. The text is in the page; the data of everything that moves is in its data block.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const root = document.documentElement;
  root.classList.add("scripted");
  const $ = (id) => document.getElementById(id);
  const SVG = "http://www.w3.org/2000/svg";
  const SECONDS_TO_WATCH = 25;
  const EPSILON_S = 1e-6;

  const decisionTimes = [...new Set(data.runs.flatMap((run) => run.decisions.map((one) => one.t)))].sort((a, b) => a - b);
  let now = 0, playing = false, before = null, object = 0;

  // The last entry of a list sorted by time that is not later than t; -1 before the first.
  const lastUntil = (list, t, time) => {
    let low = 0, high = list.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time(list[middle]) <= t + EPSILON_S) low = middle + 1; else high = middle;
    }
    return low - 1;
  };

  // The points of the first `share` of a path given as x, y, x, y.
  const partOf = (path, share) => {
    let total = 0;
    for (let i = 2; i < path.length; i += 2) total += Math.hypot(path[i] - path[i - 2], path[i + 1] - path[i - 1]);
    let left = total * share;
    const points = [path[0], path[1]];
    for (let i = 2; i < path.length; i += 2) {
      const dx = path[i] - path[i - 2], dy = path[i + 1] - path[i - 1], length = Math.hypot(dx, dy);
      if (length > left) {
        points.push(path[i - 2] + dx * left / length, path[i - 1] + dy * left / length);
        return points;
      }
      left -= length;
      points.push(path[i], path[i + 1]);
    }
    return points;
  };

  const describe = (leg) => {
    const [kind, , , container, thing] = leg;
    const where = container >= 0 ? data.names[container] : "";
    if (kind === "move") return `drives to ${where}`;
    if (kind === "search") return `searches ${where}`;
    if (kind === "interact") return `reaches ${data.objects[thing]}`;
    return "waits";
  };

  const views = data.runs.map((run, index) => {
    const article = document.querySelector(`[data-run="${index}"]`);
    const map = article.querySelector("svg.map");
    const aims = map.querySelector(".aims");
    const trails = [...map.querySelectorAll(".trail")].map((group) => {
      group.replaceChildren();
      return group.appendChild(document.createElementNS(SVG, "path"));
    });
    const lines = run.robots.map((_, robot) => {
      const line = aims.appendChild(document.createElementNS(SVG, "path"));
      line.setAttribute("class", `aim robot-${robot}`);
      return line;
    });
    const containers = [...map.querySelectorAll(".container")].map((shape) => ({
      shape,
      index: Number(shape.dataset.container),
      title: shape.querySelector("title"),
      label: map.querySelector(`[data-label="${shape.dataset.container}"]`),
      middle: (() => { const box = shape.getBBox(); return [box.x + box.width / 2, box.y + box.height / 2]; })(),
    }));
    const chart = article.querySelector(".chart svg");
    return {
      run, article, map, trails, lines, containers,
      middleOf: Object.fromEntries(containers.map((one) => [one.index, one.middle])),
      robots: [...map.querySelectorAll(".robot")],
      timed: [...map.querySelectorAll("[data-at]")].map((mark) => [mark, Number(mark.dataset.at)]),
      doing: [...article.querySelectorAll(".doing li > span:last-child")],
      clock: article.querySelector(".clock"),
      states: [...article.querySelectorAll(".state")],
      decisions: [...article.querySelectorAll(".decision")],
      cursor: chart && { line: chart.querySelector(".now"), left: Number(chart.dataset.left),
        right: Number(chart.dataset.right), end: Number(chart.dataset.end) },
    };
  });

  const showRobots = (view, t) => {
    view.run.robots.forEach((legs, robot) => {
      const current = lastUntil(legs, t, (leg) => leg[1]);
      let at = view.run.start, path = "", text = "waits", aim = null, works = false;
      for (let index = 0; index <= current; index += 1) {
        const leg = legs[index];
        const under = leg[2] > t + EPSILON_S;
        if (leg[0] === "move") {
          const points = under ? partOf(leg[5], (t - leg[1]) / (leg[2] - leg[1])) : leg[5];
          path += "M" + points.join(" ");
          at = points.slice(-2);
        } else {
          at = leg[5].slice(-2);
        }
        if (under) {
          text = describe(leg);
          aim = leg[0] === "move" ? view.middleOf[leg[3]] : null;
          works = leg[0] === "search" || leg[0] === "interact";
        }
      }
      if (t >= view.run.end - EPSILON_S) text = view.run.cost === null ? "stopped" : "done";
      view.trails[robot].setAttribute("d", path);
      view.lines[robot].setAttribute("d", aim ? `M${at[0]} ${at[1]}L${aim[0]} ${aim[1]}` : "");
      view.robots[robot].setAttribute("transform", `translate(${at[0]} ${at[1]})`);
      view.robots[robot].classList.toggle("works", works);
      if (view.doing[robot].textContent !== text) view.doing[robot].textContent = text;
    });
  };

  const showBelief = (view, decision, t) => {
    const found = new Map();
    for (const [at, container, objects] of view.run.finds) if (at <= t + EPSILON_S) found.set(container, objects);
    const belief = decision >= 0 ? view.run.decisions[decision].belief[object] : null;
    for (const { shape, index, title, label } of view.containers) {
      const objects = found.get(index);
      const seen = objects !== undefined;
      shape.classList.toggle("found", seen && objects.length > 0);
      shape.classList.toggle("empty", seen && objects.length === 0);
      label?.classList.toggle("known", seen);
      const share = belief && !seen ? belief[index] / 1000 : 0;
      // Most likelihoods are small: the square root spreads them over the colours.
      shape.style.setProperty("--p", Math.sqrt(share).toFixed(3));
      const name = data.names[index];
      if (seen) title.textContent = objects.length ? `${name}: ${objects.map((one) => data.objects[one]).join(", ")}` : `${name}: nothing for this task`;
      else title.textContent = belief ? `${name}: ${data.objects[object]} with ${(100 * share).toFixed(1)} %` : name;
    }
  };

  const render = () => {
    for (const view of views) {
      const { run } = view, t = Math.min(now, run.end);
      showRobots(view, t);
      const decision = lastUntil(run.decisions, now, (one) => one.t);
      showBelief(view, decision, t);
      for (const [mark, at] of view.timed) mark.classList.toggle("later", at > t + EPSILON_S);
      const state = run.states[Math.max(lastUntil(run.states, t, (one) => one[0]), 0)][1];
      const passed = new Set(run.states.filter(([at]) => at <= t + EPSILON_S).map(([, one]) => one));
      for (const node of view.states) {
        const own = Number(node.dataset.state);
        node.classList.toggle("present", own === state);
        node.classList.toggle("passed", own !== state && passed.has(own));
      }
      view.decisions.forEach((card, index) => card.classList.toggle("present", index === decision));
      const over = now >= run.end - EPSILON_S;
      view.article.classList.toggle("done", over && run.cost !== null);
      view.clock.textContent = over ? "" : `${t.toFixed(1)} s`;
      if (view.cursor) {
        const { line, left, right, end } = view.cursor;
        const x = left + (right - left) * Math.min(t / end, 1);
        line.setAttribute("transform", `translate(${(x - left).toFixed(1)} 0)`);
      }
    }
    $("time").value = now;
    const text = `${now.toFixed(1)} s`;
    $("now").textContent = text;
    $("time").setAttribute("aria-valuetext", text);
  };

  const seek = (t) => { now = Math.min(Math.max(t, 0), data.end); render(); };
  const setPlaying = (on) => {
    playing = on && data.end > 0;
    before = null;
    $("play").classList.toggle("playing", playing);
    $("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    if (playing) {
      if (now >= data.end) now = 0;
      requestAnimationFrame(step);
    }
  };
  const step = (clock) => {
    if (!playing) return;
    if (before !== null) now = Math.min(now + (clock - before) / 1000 * Number($("speed").value), data.end);
    before = clock;
    render();
    if (now >= data.end) setPlaying(false); else requestAnimationFrame(step);
  };
  const toDecision = (direction) => {
    if (!decisionTimes.length) return;
    const times = direction > 0 ? decisionTimes.filter((t) => t > now + EPSILON_S) : decisionTimes.filter((t) => t < now - EPSILON_S);
    setPlaying(false);
    seek(direction > 0 ? times[0] ?? data.end : times[times.length - 1] ?? 0);
  };
  const choose = (index) => {
    if (index >= data.objects.length) return;
    object = index;
    document.querySelectorAll("[data-object]").forEach((button) => {
      button.setAttribute("aria-pressed", String(Number(button.dataset.object) === index));
    });
    render();
  };
  const changeSpeed = (by) => {
    const select = $("speed");
    select.selectedIndex = Math.min(Math.max(select.selectedIndex + by, 0), select.options.length - 1);
  };
  const reveal = () => views.forEach(({ map }) => map.classList.toggle("reveal", $("reveal").checked));

  $("play").addEventListener("click", () => setPlaying(!playing));
  // A replay without decisions has no buttons for them.
  $("back")?.addEventListener("click", () => toDecision(-1));
  $("next")?.addEventListener("click", () => toDecision(1));
  $("time").addEventListener("input", (event) => { setPlaying(false); seek(Number(event.target.value)); });
  $("reveal").addEventListener("change", reveal);
  document.querySelectorAll("[data-object]").forEach((button) => button.addEventListener("click", () => choose(Number(button.dataset.object))));
  document.querySelectorAll("[data-seek]").forEach((button) => button.addEventListener("click", () => { setPlaying(false); seek(Number(button.dataset.seek)); }));
  document.querySelectorAll(".all").forEach((button) => button.addEventListener("click", () => {
    const whole = button.closest(".why").classList.toggle("whole");
    button.setAttribute("aria-pressed", String(whole));
  }));

  const keys = {
    " ": () => setPlaying(!playing),
    ArrowLeft: (event) => event.shiftKey ? toDecision(-1) : (setPlaying(false), seek(now - 1)),
    ArrowRight: (event) => event.shiftKey ? toDecision(1) : (setPlaying(false), seek(now + 1)),
    Home: () => { setPlaying(false); seek(0); },
    End: () => { setPlaying(false); seek(data.end); },
    "+": () => changeSpeed(1), "=": () => changeSpeed(1), "-": () => changeSpeed(-1),
    w: () => { $("reveal").checked = !$("reveal").checked; reveal(); },
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    // A focused button or list keeps the keys that it understands itself.
    if (event.target.closest("select") || (event.key === " " && event.target.closest("button"))) return;
    if (/^[1-9]$/.test(event.key)) { choose(Number(event.key) - 1); return; }
    const act = keys[event.key] ?? keys[event.key.toLowerCase()];
    if (!act) return;
    event.preventDefault();
    act(event);
  });

  const ticks = document.querySelector(".ticks");
  if (data.end > 0) {
    for (const t of decisionTimes) {
      const tick = ticks.appendChild(document.createElement("i"));
      tick.style.left = `${100 * t / data.end}%`;
    }
  }
  const speeds = [...$("speed").options].map((option) => Number(option.value));
  const wanted = data.end / SECONDS_TO_WATCH;
  $("speed").selectedIndex = Math.max(speeds.findIndex((speed) => speed >= wanted), 0);
  if (wanted > speeds[speeds.length - 1]) $("speed").selectedIndex = speeds.length - 1;

  const fit = () => {
    for (const { map } of views) {
      const { width, height } = map.viewBox.baseVal, box = map.getBoundingClientRect();
      if (box.width > 0) map.style.setProperty("--unit", Math.max(width / box.width, height / box.height).toFixed(3));
    }
  };
  new ResizeObserver(fit).observe(document.body);
  let shown = 0;
  addEventListener("beforeprint", () => { shown = now; setPlaying(false); seek(data.end); });
  addEventListener("afterprint", () => seek(shown));
  fit();
  reveal();
  render();
})();
