"use strict";
// The page stands without this script; it zooms the overlay and switches sensors.
{
  const at = (id) => document.getElementById(id);
  for (const part of document.querySelectorAll(".live")) part.hidden = false;

  // Residual over covariates: one sensor at a time.
  const located = at("located-sensor");
  const showLocated = () => {
    for (const part of document.querySelectorAll(".of-sensor")) part.hidden = part.dataset.sensor !== located.value;
  };
  located?.addEventListener("change", showLocated);
  if (located) showLocated(); // a browser that goes back keeps the choice

  const plots = at("plots");
  if (plots) overlay(JSON.parse(at("traces").textContent), plots);

  function overlay(data, plots) {
    const LEFT = 58, RIGHT = 10, TOP = 8, HIGH = 150, LOW = 84, GAP = 12, FOOT = 22; // pixels
    const SHORTEST = 0.02; // seconds: two rows of the reference
    const STEP = 1.5; // one press of + or -
    const recording = at("recording"), sensor = at("sensor"), kind = at("kind"), output = at("window");
    let trace, shown, start, end, from, to, mark, drawing;

    /** Numbers from 16-bit codes; the last code is a hole. */
    function numbers([first, last, codes]) {
      const bytes = Uint8Array.from(atob(codes), (letter) => letter.charCodeAt(0));
      const view = new DataView(bytes.buffer);
      return Float64Array.from({ length: bytes.length / 2 }, (_, i) => {
        const code = view.getUint16(2 * i, true);
        return code === 65535 ? NaN : first + ((last - first) * code) / 65534;
      });
    }

    function unpack(packed) {
      const times = packed.times.map(numbers);
      const line = ({ role, time, low, high }) => {
        const least = numbers(low);
        return { role, time: times[time], low: least, high: high ? numbers(high) : least };
      };
      const panels = packed.panels.map((panel) => ({ ...panel, lines: panel.lines.map(line), left: panel.left.map(line) }));
      return { panels, start: Math.min(...times.map((t) => t[0])), end: Math.max(...times.map((t) => t[t.length - 1])) };
    }

    /** First index whose time is not before `time`. */
    function index(times, time) {
      let low = 0, high = times.length;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (times[middle] < time) low = middle + 1;
        else high = middle;
      }
      return low;
    }

    /** What of a line lies in the window, with a neighbour on each side, in at most `most` stretches. */
    function visible(line, most) {
      const first = Math.max(0, index(line.time, from) - 1);
      const last = Math.min(line.time.length, index(line.time, to) + 1);
      const each = Math.max(1, Math.ceil((last - first) / most));
      const points = [];
      for (let i = first; i < last; i += each) {
        let low = Infinity, high = -Infinity;
        const next = Math.min(last, i + each);
        for (let j = i; j < next; j++) {
          if (line.low[j] < low) low = line.low[j];
          if (line.high[j] > high) high = line.high[j];
        }
        points.push(low > high ? null : { time: (line.time[i] + line.time[next - 1]) / 2, low, high });
      }
      return { role: line.role, points };
    }

    /** Values at which an axis is labelled, and how. */
    function ticks(low, high, count) {
      const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
      const step = power * ([1, 2, 5].find((times) => times * power >= rough) ?? 10);
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      const values = [];
      for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(k * step);
      return values.map((value) => [value, value.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "\u2212")]);
    }

    function path({ role, points }, x, y) {
      let text = "";
      const put = (run) => {
        if (!run.length) return;
        const place = (side) => (p) => `${x(p.time).toFixed(1)},${y(p[side]).toFixed(1)}`;
        const flat = run.every((p) => p.low === p.high);
        const back = flat ? "" : "L" + run.map(place("low")).reverse().join("L") + "Z";
        text += `<path class="curve r${role}${flat ? "" : " band"}" d="M${run.map(place("high")).join("L")}${back}"/>`;
        // The second model's dashes would be lost in a band.
        const middle = (p) => `${x(p.time).toFixed(1)},${y((p.low + p.high) / 2).toFixed(1)}`;
        if (role === 2 && !flat) text += `<path class="curve r2" d="M${run.map(middle).join("L")}"/>`;
      };
      let run = [];
      for (const point of points) {
        if (point) run.push(point);
        else put(run), (run = []);
      }
      put(run);
      return text;
    }

    /** One plot of lines with its frame, `top` pixels down. */
    function chart(lines, width, top, height, unit, clip, withTime) {
      const seen = lines.map((line) => visible(line, width));
      let low = Infinity, high = -Infinity;
      for (const point of seen.flatMap((line) => line.points)) {
        if (point && point.low < low) low = point.low;
        if (point && point.high > high) high = point.high;
      }
      if (low > high) (low = -1), (high = 1);
      const margin = high > low ? 0.05 * (high - low) : 0.5;
      (low -= margin), (high += margin);
      const x = (time) => LEFT + ((time - from) / (to - from)) * width;
      const y = (value) => top + height - ((value - low) / (high - low)) * height;
      let text = `<clipPath id="${clip}"><rect x="${LEFT}" y="${top}" width="${width}" height="${height}"/></clipPath>`;
      for (const [value, label] of ticks(low, high, height / 22)) {
        text += `<path class="${Number(label) === 0 ? "zero" : "grid"}" d="M${LEFT},${y(value)}H${LEFT + width}"/>`;
        text += `<text x="${LEFT - 6}" y="${y(value)}" dy=".35em" text-anchor="end">${label}</text>`;
      }
      for (const [value, label] of ticks(from, to, width / 64)) {
        text += `<path class="grid" d="M${x(value)},${top}V${top + height}"/>`;
        if (withTime) text += `<text class="time" x="${x(value)}" y="${top + height + 15}" text-anchor="middle">${label}</text>`;
      }
      text += `<text class="unit" transform="translate(11,${top + height / 2}) rotate(-90)" text-anchor="middle">${unit}</text>`;
      if (withTime) text += `<text class="unit" x="${LEFT - 16}" y="${top + height + 15}" text-anchor="end">time, s</text>`;
      if (mark) text += `<rect class="chosen" x="${x(mark[0])}" y="${top}" width="${x(mark[1]) - x(mark[0])}" height="${height}" clip-path="url(#${clip})"/>`;
      return text + `<g clip-path="url(#${clip})">${seen.map((line) => path(line, x, y)).join("")}</g>`;
    }

    // Sums of times are rounded.
    const whole = () => to - from > (end - start) * (1 - 1e-9);
    const inner = () => Math.max(120, plots.clientWidth - LEFT - RIGHT);

    function draw() {
      drawing = 0;
      const width = inner(), height = TOP + HIGH + GAP + LOW + FOOT;
      shown = trace.panels.filter((panel) => !kind.value || panel.kind === kind.value);
      plots.innerHTML = shown.map((panel, i) => {
        const above = chart(panel.lines, width, TOP, HIGH, panel.unit, `above-${i}`, false);
        const below = chart(panel.left, width, TOP + HIGH + GAP, LOW, `error, ${panel.unit}`, `below-${i}`, true);
        const says = `${panel.name} in ${panel.unit} from ${from.toFixed(2)} to ${to.toFixed(2)} s, measured and modelled; their difference below`;
        return `<h3>${panel.name}, in ${panel.unit} <span>below: ${panel.sign}</span></h3><svg role="img" aria-label="${says}" viewBox="0 0 ${LEFT + width + RIGHT} ${height}">${above}${below}<rect class="hair" y="${TOP}" height="${HIGH + GAP + LOW}" width="0"/><rect class="chosen drag" y="${TOP}" height="${HIGH + GAP + LOW}" width="0"/></svg>`;
      }).join("") || "<p>Nothing of this kind in this recording.</p>";
      const all = whole();
      plots.classList.toggle("zoomed", !all);
      output.textContent = `${from.toFixed(2)} to ${to.toFixed(2)} s`;
      document.dispatchEvent(new CustomEvent("interval", { detail: { recording: recording.value, sensor: Number(sensor.value), from, to } }));
      for (const button of document.querySelectorAll("[data-zoom]")) button.disabled = all && button.dataset.zoom !== "in";
    }

    /** Shows this stretch, or as much of it as there is. */
    function show(newFrom, newTo) {
      const length = Math.min(end - start, Math.max(SHORTEST, newTo - newFrom));
      from = Math.min(Math.max(start, (newFrom + newTo - length) / 2), end - length);
      to = from + length;
      drawing ||= requestAnimationFrame(draw);
    }
    const zoom = (times, time = (from + to) / 2) => show(time - (time - from) / times, time + (to - time) / times);
    const move = (share) => show(from + share * (to - from), to + share * (to - from));
    const steps = { in: () => zoom(STEP), out: () => zoom(1 / STEP), back: () => move(-0.25), on: () => move(0.25), all: () => show(start, end) };

    // Which trace.
    const option = (text, value) => Object.assign(document.createElement("option"), { textContent: text, value });
    const fill = (select, entries) => {
      const before = select.value;
      select.replaceChildren(...entries.map(([text, value]) => option(text, value)));
      if (entries.some(([, value]) => value === before)) select.value = before;
    };
    function choose() {
      const of = data.traces.filter((t) => t.recording === recording.value);
      fill(sensor, of.map((t) => [`s${t.sensor}`, String(t.sensor)]));
      const found = of.find((t) => String(t.sensor) === sensor.value) ?? of[0];
      const [oldStart, oldEnd] = [start, end];
      trace = unpack(found);
      ({ start, end } = trace);
      // Another sensor of the same recording is looked at in the same window.
      start === oldStart && end === oldEnd ? show(from, to) : show(start, end);
    }
    const forget = () => ((mark = undefined), choose());
    fill(recording, [...new Set(data.traces.map((t) => t.recording))].map((name) => [name, name]));
    recording.addEventListener("change", forget);
    sensor.addEventListener("change", choose);
    kind.addEventListener("change", () => show(from, to));

    function goto(button) {
      recording.value = button.dataset.recording;
      choose();
      sensor.value = button.dataset.sensor;
      choose();
    }
    const worst = [...document.querySelectorAll("[data-recording]")];
    for (const button of worst) {
      button.addEventListener("click", () => {
        goto(button);
        mark = [Number(button.dataset.from), Number(button.dataset.to)];
        const around = Math.max(0.25, (mark[1] - mark[0]) / 2);
        if (kind.value === "force") kind.value = "";
        show(mark[0] - around, mark[1] + around);
        at("overlay").scrollIntoView();
        plots.focus({ preventScroll: true });
      });
    }
    worst.length ? goto(worst[0]) : choose();

    // Buttons, keys, wheel.
    for (const button of document.querySelectorAll("[data-zoom]")) {
      button.addEventListener("click", () => steps[button.dataset.zoom]());
    }
    const keys = { "+": "in", "=": "in", "-": "out", ArrowLeft: "back", ArrowRight: "on", 0: "all", Home: "all" };
    plots.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
      event.preventDefault();
      steps[keys[event.key]]();
    });
    const timeAt = (clientX) => from + ((clientX - plots.getBoundingClientRect().left - LEFT) / inner()) * (to - from);
    plots.addEventListener("wheel", (event) => {
      // Only once a plot was clicked, or with Ctrl: the page itself must stay easy to scroll.
      if (!event.ctrlKey && document.activeElement !== plots) return;
      // Zooming out of the whole is scrolling on.
      if (event.deltaY > 0 && whole() && !event.ctrlKey) return;
      event.preventDefault();
      zoom(Math.exp(-0.002 * event.deltaY * (event.deltaMode ? 30 : 1)), timeAt(event.clientX));
    }, { passive: false });

    // Fingers and mouse: one chooses a stretch or moves, two pinch.
    const down = new Map();
    let drag;
    const ends = () => [...down.values()].sort((a, b) => a - b);
    function begin(event) {
      if (event.button > 0) return;
      plots.focus({ preventScroll: true });
      plots.setPointerCapture(event.pointerId);
      down.set(event.pointerId, event.clientX);
      drag = { by: down.size > 1 ? "pinch" : whole() || event.shiftKey ? "choose" : "move", x: event.clientX, times: ends().map(timeAt) };
      outline(0, 0);
    }
    function outline(left, width) {
      for (const rect of plots.querySelectorAll(".drag")) rect.setAttribute("x", left), rect.setAttribute("width", width);
    }
    const chosen = (event) => [drag.times[0], timeAt(event.clientX)].sort((a, b) => a - b).map((t) => Math.min(end, Math.max(start, t)));
    function continues(event) {
      if (!drag || !down.has(event.pointerId)) return;
      down.set(event.pointerId, event.clientX);
      if (drag.by === "choose") {
        const [first, last] = chosen(event).map((time) => LEFT + ((time - from) / (to - from)) * inner());
        outline(first, last - first);
      } else if (drag.by === "move") {
        const by = ((drag.x - event.clientX) / inner()) * (to - from);
        drag.x = event.clientX;
        show(from + by, to + by);
      } else if (down.size > 1) {
        // Both fingers stay on the times that they touched.
        const [a, b] = ends(), left = plots.getBoundingClientRect().left + LEFT;
        const perPixel = (drag.times[1] - drag.times[0]) / Math.max(8, b - a);
        const newFrom = drag.times[0] - (a - left) * perPixel;
        if (perPixel > 0) show(newFrom, newFrom + perPixel * inner());
      }
    }
    function finish(event) {
      if (!down.delete(event.pointerId) || !drag) return;
      const dragged = event.type === "pointerup" && drag.by === "choose" && Math.abs(event.clientX - drag.x) > 5;
      if (dragged) show(...chosen(event));
      else outline(0, 0);
      drag = undefined;
    }
    // What the curves say under the mouse.
    const names = ["measured", ...(trace.panels[0]?.left.length > 1 ? ["A", "B"] : ["modelled"])];
    function read(event) {
      const panel = shown[[...plots.querySelectorAll("svg")].indexOf(event.target.closest("svg"))];
      const time = timeAt(event.clientX);
      const inside = panel && !drag && time >= from && time <= to;
      const x = LEFT + ((time - from) / (to - from)) * inner();
      for (const hair of plots.querySelectorAll(".hair")) hair.setAttribute("x", inside ? x : 0), hair.setAttribute("width", inside ? 1 : 0);
      if (!inside) return;
      const values = panel.lines.map((line) => {
        const i = Math.min(line.time.length - 1, index(line.time, time));
        const value = (line.low[i] + line.high[i]) / 2;
        return `${names[line.role]} ${Number.isNaN(value) ? "none" : value.toFixed(2).replace("-", "\u2212") + " " + panel.unit}`;
      });
      at("value").textContent = `${panel.name} at ${time.toFixed(2)} s: ${values.join(", ")}`;
    }
    plots.addEventListener("pointermove", (event) => event.pointerType === "mouse" && read(event));
    plots.addEventListener("pointerdown", begin);
    plots.addEventListener("pointermove", continues);
    plots.addEventListener("pointerup", finish);
    plots.addEventListener("pointercancel", finish);

    let before = plots.clientWidth;
    new ResizeObserver(() => {
      // Plots that those of another model have replaced lose their width, too.
      if (plots.isConnected && plots.clientWidth !== before) (before = plots.clientWidth), show(from, to);
    }).observe(plots);
  }
}
