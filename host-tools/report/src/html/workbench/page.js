"use strict";
{
  const at = (id) => document.getElementById(id);
  const nonce = document.currentScript.nonce;
  const token = new URLSearchParams(location.search).get("token") ?? "";
  // A model is its effects and formulas. The history holds those that were shown, for undo and redo; `shown` is the server's answer
  // to the one at `place`. Both change only after an answer, one request for a model at a time.
  const empty = { effects: [], formulas: [] };
  // A page that is loaded again goes on where it was.
  const STORED = `workbench ${token}`;
  let history = [], place = -1, shown, names, isBusy = false;
  let chosen; // the model to compare with, once it was selected; else the base
  const fitted = new Map(); // every model that was shown, by its key
  const current = () => history[place] ?? empty;
  const key = (model) => JSON.stringify([model.effects, model.formulas]);
  const name = (formula) => formula.split(":")[0].trim();
  const title = (model) => [...model.effects, ...model.formulas.map(name)].join(" + ") || "base";

  function element(tag, properties = {}, ...children) {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  }

  async function ask(path, body) {
    const answer = await fetch(path, {
      method: "POST",
      headers: { "content-type": "application/json", "x-token": token },
      body: JSON.stringify(body),
    });
    const content = await answer.text();
    if (answer.ok) return JSON.parse(content);
    // The server's own errors are objects, those of its library text.
    throw new Error(content.startsWith("{") ? JSON.parse(content).error : content);
  }

  const newtons = (value) => `${value.toFixed(3)} N`;

  /** Error, predicted error of the effect under the pointer, and noise, on one scale. */
  function bar(predicted) {
    const force = shown?.force;
    at("legend").hidden = !force;
    if (!force) return at("bar").replaceChildren();
    const most = Math.max(force.rms_n, shown.baseline_force?.rms_n ?? 0);
    const part = (name, value) => element("span", { className: name, style: `width:${(100 * value) / most}%` });
    const parts = [part("error", force.rms_n)];
    if (predicted) parts.push(part("predicted", predicted));
    parts.push(part("noise", force.noise_n));
    at("bar").replaceChildren(...parts);
    const words = `Force error ${newtons(force.rms_n)}, noise ${newtons(force.noise_n)}`;
    at("bar").setAttribute("aria-label", predicted ? `${words}, predicted ${newtons(predicted)}` : words);
  }

  function headline(predicted) {
    if (!shown.force) return (at("headline").textContent = shown.verdict);
    at("headline").textContent = shown.headline;
    // In a place of its own size: a page that moves under the pointer would show and hide it again and again.
    at("predicted").textContent = predicted ? newtons(predicted) : "";
    at("verdict").textContent = `${shown.verdict} Held-out rows: ${shown.validation}.`;
  }

  /** Shows the force error with the predicted excess of a candidate, or without one. */
  function preview(excess) {
    const predicted = shown.force && Number.isFinite(excess) ? Math.hypot(shown.force.noise_n, excess) : undefined;
    bar(predicted);
    headline(predicted);
  }

  function choice(name, right, more, act) {
    const button = element("button", { type: "button" }, element("span", { textContent: name }), element("span", { className: "fall", textContent: right }));
    if (more) button.append(element("span", { className: "more", textContent: more }));
    button.addEventListener("click", act);
    return element("li", {}, button);
  }

  const precise = (value) => (Number.isFinite(value) ? Number(value.toPrecision(3)).toString() : "\u2013");

  function draw() {
    const { effects, formulas } = current();
    at("present").replaceChildren(
      ...shown.present.map((effect) => {
        const size = effect.value === null ? "" : `${precise(effect.value)}\u00b1${precise(effect.std_error)} ${effect.unit}`;
        const without = effect.formula
          ? { effects, formulas: formulas.filter((text) => name(text) !== effect.name) }
          : { effects: effects.filter((name) => name !== effect.name), formulas };
        const item = choice(effect.name, "remove", [effect.formula, size, effect.device].filter(Boolean).join("; "), () => go(without));
        item.dataset.effect = effect.name;
        return item;
      }),
    );
    if (!shown.present.length) at("present").append(element("li", { className: "note", textContent: "No effects: the base physics alone." }));
    const candidates = shown.candidates.map((one) => {
      const fall = one.excess_n === null ? `\u2212${(100 * Math.max(0, one.gain)).toFixed(1)} %` : newtons(one.excess_n);
      const verdict = one.is_significant ? `significant by itself, p ${one.p.toFixed(3)}` : one.p < 0.05 ? `small, or not lower in every fold; p ${one.p.toFixed(3)}` : `not significant, p ${one.p.toFixed(2)}`;
      const item = choice(one.name, fall, `${one.title}; ${verdict}`, () => go({ effects: [...effects, one.name], formulas }));
      item.dataset.effect = one.name;
      item.title = one.physics;
      for (const [start, end] of [["mouseenter", "mouseleave"], ["focusin", "focusout"]]) {
        item.addEventListener(start, () => preview(one.excess_n ?? undefined));
        item.addEventListener(end, () => preview());
      }
      return [one.is_significant, item];
    });
    const items = (wanted) => candidates.filter(([is_significant]) => is_significant === wanted).map(([, item]) => item);
    at("candidates").replaceChildren(...items(true));
    if (!items(true).length) at("candidates").append(element("li", { className: "note", textContent: "No effect of the catalogue is significant. If structure remains, try a formula." }));
    at("others").replaceChildren(...items(false));
    at("untestable").parentElement.hidden = !shown.untestable.length;
    at("untestable").replaceChildren(...shown.untestable.map((one) => element("li", { textContent: `${one.name}: ${one.reason}. ${one.record}` })));
    at("undo").disabled = place === 0;
    at("redo").disabled = place === history.length - 1;
    baselines();
    preview();
    at("commands").textContent = shown.commands.join("\n");
    at("diagnosis-result").replaceChildren();
    at("error").textContent = "";
    at("notes").replaceChildren(...shown.notes.map((text) => element("li", { textContent: text })));
    const view = at("view");
    view.innerHTML = shown.view;
    // Scripts in replaced content do not run by themselves.
    view.append(element("script", { nonce, textContent: at("view-script").textContent }));
  }

  /** Models to compare with. */
  function baselines() {
    const others = new Map([["", "nothing"]]);
    for (const [own, model] of fitted) others.set(own, title(model));
    others.delete(key(current()));
    at("baseline").replaceChildren(...[...others].map(([value, text]) => element("option", { value, textContent: text })));
    const wanted = chosen ?? key(empty);
    at("baseline").value = others.has(wanted) ? wanted : "";
  }

  /** The model to compare `model` with. */
  function baselineOf(model) {
    const wanted = chosen ?? key(empty);
    return wanted === key(model) ? undefined : fitted.get(wanted);
  }

  /** Asks for a model and shows it; `accept` changes the history. True if it could be fitted. */
  async function show(model, accept) {
    if (isBusy) return false;
    isBusy = true;
    at("cancel").hidden = false;
    at("view").setAttribute("aria-busy", "true");
    at("choices").inert = true;
    try {
      shown = await ask("model", { ...model, baseline: baselineOf(model) });
      accept();
      fitted.set(key(model), model);
      sessionStorage.setItem(STORED, JSON.stringify({ history, place, chosen }));
      draw();
      return true;
    } catch (error) {
      at("error").textContent = error.message;
      if (!shown) at("headline").textContent = "No model could be fitted.";
      return false;
    } finally {
      isBusy = false;
      at("cancel").hidden = true;
      at("choices").inert = false;
      at("view").setAttribute("aria-busy", "false");
    }
  }

  /** A new model, which ends what could be redone. */
  const go = (model) =>
    show(model, () => {
      history = [...history.slice(0, place + 1), model];
      place = history.length - 1;
    });

  function step(by) {
    const model = history[place + by];
    if (model) show(model, () => (place += by));
  }

  /** What is missing from the shown model, with buttons that add it. */
  async function diagnose(plans) {
    const model = current(), result = at("diagnosis-result");
    for (const id of ["diagnose", "plan"]) at(id).disabled = true;
    at("cancel").hidden = false;
    result.replaceChildren(element("p", { className: "note", textContent: plans ? "Diagnosing and planning: up to a minute." : "Diagnosing: some seconds." }));
    try {
      const found = await ask("diagnose", { ...model, plans });
      if (model !== current()) return;
      const add = (text, effects, formulas, evidence) => {
        const button = element("button", { type: "button" }, element("span", { textContent: text }));
        if (evidence) button.append(element("span", { className: "more", textContent: evidence }));
        button.addEventListener("click", () => go({ effects: [...model.effects, ...effects], formulas: [...model.formulas, ...formulas] }));
        return element("li", {}, button);
      };
      const parts = found.steps.flatMap((step) => step.map((name) => add(step.length > 1 ? `Add ${name}: one of ${step.length} that explain the same` : `Add ${name}`, [name], [], found.evidence[name])));
      parts.push(...found.formulas.map((one) => add(`Add ${one.formulas.join(" and ")}`, [], one.formulas, `gain ${(100 * one.gain).toFixed(1)} %, p ${one.p.toFixed(3)}. ${one.device}`)));
      const nothing = found.at_floor ? "No missing effect was found: the residual is at its noise floor." : "Neither the catalogue nor formulas explain what is left.";
      result.replaceChildren(
        element("p", { className: "note", textContent: [found.missing.trim(), found.headline].filter(Boolean).join(" ") }),
        parts.length ? element("ul", {}, ...parts) : element("p", { className: "note", textContent: nothing }),
      );
      if (found.plan) result.append(element("div", { innerHTML: found.plan }));
    } catch (error) {
      result.replaceChildren(element("p", { className: "note", textContent: error.message }));
    } finally {
      for (const id of ["diagnose", "plan"]) at(id).disabled = false;
      at("cancel").hidden = !isBusy;
    }
  }
  at("diagnose").addEventListener("click", () => diagnose(false));
  at("plan").addEventListener("click", () => diagnose(true));

  // The scatter follows the time interval that the plots over time show.
  let interval, waiting, latest = 0;
  function follow() {
    clearTimeout(waiting);
    waiting = setTimeout(async () => {
      if (!interval || !at("covariate").value || !shown) return;
      const own = ++latest;
      let plot, message;
      try {
        const request = { choice: current(), covariate: at("covariate").value, interval: { ...interval, axis: Number(at("scatter-axis").value) } };
        plot = (await ask("scatter", request)).plot;
      } catch (error) {
        message = error.message;
      }
      if (own !== latest) return;
      if (plot) at("scatter-plot").innerHTML = plot;
      else at("scatter-plot").textContent = message;
    }, 150);
  }
  document.addEventListener("interval", (event) => ((interval = event.detail), follow()));
  for (const id of ["covariate", "scatter-axis"]) at(id).addEventListener("change", follow);

  at("cancel").addEventListener("click", () => ask("cancel", {}).catch((error) => (at("error").textContent = error.message)));
  at("undo").addEventListener("click", () => step(-1));
  at("redo").addEventListener("click", () => step(1));
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || event.target.matches("input")) return;
    event.preventDefault();
    step(event.shiftKey ? 1 : -1);
  });
  at("baseline").addEventListener("change", () => {
    chosen = at("baseline").value;
    show(current(), () => {});
  });
  at("formula-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const text = at("formula").value.trim();
    if (!text) return;
    const { effects, formulas } = current();
    if (await go({ effects, formulas: [...formulas, text] })) at("formula").value = "";
  });
  const files = { model: "model.toml", tables: "tables.rs", report: "report.html", plan: "plan.toml" };
  at("write-kind").addEventListener("change", () => {
    const file = files[at("write-kind").value];
    at("write-path").value = file ?? "";
    at("write-path").hidden = file === undefined;
  });
  at("write-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const body = { ...current(), baseline: baselineOf(current()), kind: at("write-kind").value, path: at("write-path").value };
    at("written").textContent = body.kind === "board" ? "Uploading: some seconds." : "";
    try {
      at("written").textContent = (await ask("write", body)).message;
    } catch (error) {
      at("written").textContent = error.message;
    }
  });
  at("reload").addEventListener("click", async () => {
    try {
      await ask("reload", {});
    } catch (error) {
      return (at("written").textContent = error.message);
    }
    at("written").textContent = "";
    if (await show(current(), () => {})) nameFormulas();
  });

  // The gripper, ten times a second.
  const PERIOD_MS = 100, SHOWN_S = 20, SILENT_S = 1;
  const LINES = [["ink", []], ["first", [6, 3]], ["second", [2, 2]], ["third", [8, 3, 2, 3]]];
  const past = [];
  function strip(canvas, force) {
    const context = canvas.getContext("2d"), scale = devicePixelRatio || 1;
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== wide * scale) [canvas.width, canvas.height] = [wide * scale, high * scale];
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, wide, high);
    const values = past.flatMap(({ sensors, measured }) => [...sensors.map((one) => one[force]), ...measured[force].filter((value) => value !== undefined)]);
    const most = Math.max(1, ...values.map(Math.abs)), now = past[past.length - 1].time_s;
    const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
    const y = (value) => high / 2 - (value / most) * (high / 2 - 8);
    context.strokeStyle = colour("grid");
    context.setLineDash([]);
    context.strokeRect(0, y(0), wide, 0);
    context.fillStyle = colour("muted");
    context.fillText(`\u00b1${most.toFixed(1)} N`, 4, 12);
    // The reference below the estimates, wide and pale.
    context.strokeStyle = colour("muted");
    context.lineWidth = 4;
    context.globalAlpha = 0.4;
    LINES.forEach((_, sensor) => {
      context.beginPath();
      for (const { time_s, measured } of past) {
        const value = measured[force][sensor], x = wide * (1 - (now - time_s) / SHOWN_S);
        if (value !== undefined) context.lineTo(x, y(value));
      }
      context.stroke();
    });
    context.lineWidth = 1;
    context.globalAlpha = 1;
    LINES.forEach(([name, dash], sensor) => {
      context.strokeStyle = colour(name);
      context.setLineDash(dash);
      context.beginPath();
      for (const { time_s, sensors } of past) {
        const value = sensors[sensor]?.[force];
        if (value === undefined || sensors[sensor].validity === "missing") context.moveTo(wide * (1 - (now - time_s) / SHOWN_S), y(0));
        else context.lineTo(wide * (1 - (now - time_s) / SHOWN_S), y(value));
      }
      context.stroke();
    });
  }
  async function watch() {
    try {
      const { name: line, ended, state, recording, reference } = await ask("live", {});
      at("live-name").textContent = line;
      if (recording) at("record-lines").textContent = `${recording.lines}\n${recording.goes_on ? "Recording." : "The recording has ended. Read the campaign again to evaluate it."}`;
      const measured = (sensor, axis) => reference?.forces.find((one) => one.sensor === sensor && one.axis === axis)?.newtons;
      at("live").classList.toggle("referenced", reference !== null);
      at("reference-state").textContent = !reference ? "" : reference.error ?? (reference.forces.length ? "Grey: the reference." : "Nothing from the reference.");
      past.push({ ...state, measured: { fx_n: state.sensors.map((one) => measured(one.sensor, "x")), fz_n: state.sensors.map((one) => measured(one.sensor, "z")) } });
      while (past[0].time_s < state.time_s - SHOWN_S) past.shift();
      strip(at("live-x"), "fx_n");
      strip(at("live-z"), "fz_n");
      const isSilent = state.silent_s === null || state.silent_s > SILENT_S;
      const size = (value, sigma) => `${value.toFixed(2)}${sigma === null ? "" : ` \u00b1 ${sigma.toFixed(2)}`}`;
      const none = "\u2013";
      at("live-sensors").replaceChildren(
        ...state.sensors.map((one) => {
          const isMissing = isSilent || one.validity === "missing";
          const forces = isMissing ? [none, none] : [size(one.fx_n, one.sigma_x_n), size(one.fz_n, one.sigma_z_n)];
          const references = reference === null ? [] : ["x", "z"].map((axis) => measured(one.sensor, axis)?.toFixed(2) ?? none);
          const cells = [...forces, isSilent ? none : one.validity + (one.disturbed ? ", disturbed" : ""), isSilent ? none : one.temp_c?.toFixed(1) ?? none, ...references];
          return element("tr", {}, element("th", { textContent: one.sensor, scope: "row" }), ...cells.map((text) => element("td", { textContent: text })));
        }),
      );
      const faults = state.faults.map((one) => one.name ?? one.code).join(", ") || "no faults";
      const opening = state.covariates?.opening_mm;
      const words = [`${state.ticks_hz} ticks per second`, faults, state.heartbeat?.state, opening == null ? undefined : `opening ${opening.toFixed(1)} mm`];
      const silence = recording?.goes_on ? "Recording; not watched meanwhile." : state.silent_s === null ? "Nothing was received yet." : `Silent for ${state.silent_s.toFixed(0)} s.`;
      at("live-state").textContent = ended ?? (isSilent ? silence : words.filter(Boolean).join("; "));
      if (ended) return;
    } catch (error) {
      at("live-state").textContent = `No answer (${error.message}); trying again.`;
    }
    setTimeout(watch, PERIOD_MS);
  }
  async function command(path, body) {
    try {
      at("record-lines").textContent = "";
      await ask(path, body);
    } catch (error) {
      at("record-lines").textContent = error.message;
    }
  }
  if (at("live")) {
    watch();
    at("record-form").addEventListener("submit", (event) => {
      event.preventDefault();
      command("record", { output: at("record-output").value, plan: at("record-plan").value || null, seconds: Number(at("record-seconds").value) });
    });
    at("record-end").addEventListener("click", () => command("end-recording", {}));
  }

  /** Completes the word before the cursor, and inserts names that are clicked. */
  function insert(word) {
    const input = at("formula"), end = input.selectionStart ?? input.value.length;
    const start = input.value.slice(0, end).search(/[\w]*$/);
    input.setRangeText(word, start, end, "end");
    input.focus();
    suggest();
  }
  function suggest() {
    const input = at("formula"), end = input.selectionStart ?? input.value.length;
    const before = input.value.slice(0, end), start = before.search(/[\w]*$/), part = before.slice(start);
    const all = names ? [...names.targets, ...names.covariates, ...names.functions] : [];
    const found = part ? all.filter((word) => word.startsWith(part) && word !== part) : [];
    at("words").replaceChildren(...found.map((word) => element("option", { value: before.slice(0, start) + word + input.value.slice(end) })));
  }
  at("formula").addEventListener("input", suggest);

  async function nameFormulas() {
    try {
      names = await ask("names", {});
    } catch (error) {
      return (at("error").textContent = error.message);
    }
    const before = at("covariate").value;
    at("covariate").replaceChildren(...names.residual_covariates.map(({ name: value, words }) => element("option", { value, textContent: words })));
    if (names.residual_covariates.some((one) => one.name === before)) at("covariate").value = before;
    const parts = [["Targets", names.targets], ["Covariates", names.covariates], ["Functions", names.functions]];
    at("names").replaceChildren(
      ...parts.flatMap(([heading, list]) => [
        element("h3", { textContent: heading }),
        ...list.map((word) => {
          const button = element("button", { type: "button", textContent: word });
          button.addEventListener("click", () => insert(word));
          return button;
        }),
      ]),
    );
    follow();
  }

  async function begin() {
    const stored = JSON.parse(sessionStorage.getItem(STORED) ?? "null");
    const model = stored?.history[stored.place];
    // The base first: others are compared with it.
    await (model ? show(empty, () => {}) : go(empty));
    if (model) {
      chosen = stored.chosen;
      for (const one of stored.history) fitted.set(key(one), one);
      if (!(await show(model, () => ([history, place] = [stored.history, stored.place])))) await go(empty);
    }
    nameFormulas();
  }
  begin();
}
