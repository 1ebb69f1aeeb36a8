"use strict";
{
  const at = (id) => document.getElementById(id);
  const token = new URLSearchParams(location.search).get("token") ?? "";
  // A model is its effects and formulas. The history holds each model that was shown, for undo and redo.
  const empty = { effects: [], formulas: [] };
  let history = [empty], place = 0, shown, names, request = 0;
  let shownModel = empty; // whose state `shown` is: a wrong formula is in the history until the server refuses it
  let chosen; // the model to compare with, once it was selected; else the base
  const current = () => history[place];
  const key = (model) => JSON.stringify([model.effects, model.formulas]);
  const title = (model) => [...model.effects, ...model.formulas.map((text) => text.split(":")[0])].join(" + ") || "base";

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
    const { force, baseline_force: before } = shown;
    if (!force) return (at("headline").textContent = shown.verdict);
    const from = before ? `${newtons(before.rms_n)} \u2192 ` : "";
    const excess = before ? `${newtons(before.excess_n)} \u2192 ${newtons(force.excess_n)}` : newtons(force.excess_n);
    const more = predicted ? ` Predicted: ${newtons(predicted)}.` : "";
    at("headline").textContent =
      `Force error (held out, device's code, RMS over all forces): ${from}${newtons(force.rms_n)}; noise ${newtons(force.noise_n)}, ` +
      `excess over noise ${excess}.${more}`;
    at("verdict").textContent = `${shown.verdict} Held-out rows: ${shown.validation}.`;
  }

  /** The force error if its excess falls like the squared error of the field. */
  function predict(gain) {
    const force = shown.force;
    if (!force) return undefined;
    return Math.hypot(force.noise_n, force.excess_n * Math.sqrt(Math.max(0, 1 - gain)));
  }

  function preview(gain) {
    const predicted = gain === undefined ? undefined : predict(gain);
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
    const { effects, formulas } = shownModel;
    at("present").replaceChildren(
      ...shown.present.map((effect) => {
        const size = effect.value === null ? "" : `${precise(effect.value)}\u00b1${precise(effect.std_error)} ${effect.unit}`;
        const without = effect.formula
          ? { effects, formulas: formulas.filter((text) => text.split(":")[0].trim() !== effect.name) }
          : { effects: effects.filter((name) => name !== effect.name), formulas };
        const item = choice(effect.name, "remove", [effect.formula, size].filter(Boolean).join("; "), () => go(without));
        item.dataset.effect = effect.name;
        return item;
      }),
    );
    if (!shown.present.length) at("present").append(element("li", { className: "note", textContent: "No effects: magnet, gap, flexures and mounting only." }));
    const candidates = shown.candidates.map((one) => {
      const fall = `\u2212${(100 * Math.max(0, one.gain)).toFixed(1)} %`;
      const verdict = one.is_significant ? `significant, p ${one.p.toFixed(3)}` : `not significant, p ${one.p.toFixed(2)}`;
      const item = choice(one.name, fall, `${one.title}; ${verdict}`, () => go({ effects: [...effects, one.name], formulas }));
      item.dataset.effect = one.name;
      item.title = one.physics;
      for (const [start, end] of [["mouseenter", "mouseleave"], ["focusin", "focusout"]]) {
        item.addEventListener(start, () => preview(one.gain));
        item.addEventListener(end, () => preview());
      }
      return [one.is_significant, item];
    });
    const items = (wanted) => candidates.filter(([is_significant]) => is_significant === wanted).map(([, item]) => item);
    at("candidates").replaceChildren(...items(true));
    if (!items(true).length) at("candidates").append(element("li", { className: "note", textContent: "No effect of the catalogue is significant. If structure remains, try a formula." }));
    at("others").replaceChildren(...items(false));
    at("untestable").replaceChildren(...shown.untestable.map((one) => element("li", { textContent: `${one.name}: ${one.reason}. ${one.record}` })));
    at("undo").disabled = place === 0;
    at("redo").disabled = place === history.length - 1;
    baselines();
    preview();
    commands();
    at("diagnosis-result").replaceChildren();
    const view = at("view");
    view.innerHTML = shown.view;
    // Scripts in replaced content do not run by themselves.
    view.append(element("script", { textContent: at("view-script").textContent }));
  }

  /** Models to compare with: all that were shown. */
  function baselines() {
    const others = new Map([["", "nothing"]]);
    for (const model of history) others.set(key(model), title(model));
    others.delete(key(current()));
    at("baseline").replaceChildren(...[...others].map(([value, text]) => element("option", { value, textContent: text })));
    const wanted = chosen ?? key(empty);
    at("baseline").value = others.has(wanted) ? wanted : "";
  }

  const quote = (word) => (/^[\w./=+-]+$/.test(word) ? word : `'${word.replaceAll("'", `'\\''`)}'`);

  function commands() {
    const campaign = quote(at("campaign").textContent);
    const { effects, formulas } = current();
    const lines = [`cargo magpie fit ${campaign} -o base.toml`];
    let model = "base.toml";
    if (effects.length + formulas.length) {
      const options = (text) => {
        const [formula, ...ranges] = text.split(";").map((part) => part.trim());
        return ["--expr", quote(formula), ...ranges.flatMap((range) => ["--range", quote(range)])];
      };
      const words = [...effects, ...formulas.flatMap(options)];
      lines.push(`cargo magpie add base.toml ${campaign} ${words.join(" ")} -o model.toml`);
      model = "model.toml";
    }
    lines.push(`cargo magpie replay ${model} ${campaign}`, `cargo magpie export ${model} -o tables.rs`);
    at("commands").textContent = lines.join("\n");
  }

  /** Shows the model at `place` in the history; true if it could be fitted. */
  async function show() {
    const own = ++request;
    at("view").setAttribute("aria-busy", "true");
    baselines();
    const other = at("baseline").value;
    try {
      const baseline = other ? JSON.parse(other) : undefined;
      const model = current();
      const state = await ask("model", { ...model, baseline: baseline && { effects: baseline[0], formulas: baseline[1] } });
      if (own !== request) return true;
      [shown, shownModel] = [state, model];
      draw();
      return true;
    } catch (error) {
      if (own === request) at("headline").textContent = error.message;
      at("formula-error").textContent = error.message;
      return false;
    } finally {
      if (own === request) at("view").setAttribute("aria-busy", "false");
    }
  }

  /** A new model, which ends what could be redone. */
  async function go(model) {
    const before = [history, place];
    at("formula-error").textContent = "";
    history = [...history.slice(0, place + 1), model];
    place = history.length - 1;
    if (!(await show()) && current() === model) {
      [history, place] = before;
      baselines();
      return false;
    }
    return true;
  }

  function step(by) {
    if (place + by < 0 || place + by >= history.length) return;
    place += by;
    show();
  }

  /** What is missing from the shown model, with buttons that add it. */
  async function diagnose(plans) {
    const model = shownModel, result = at("diagnosis-result");
    for (const id of ["diagnose", "plan"]) at(id).disabled = true;
    result.replaceChildren(element("p", { className: "note", textContent: plans ? "Diagnosing and planning: up to a minute." : "Diagnosing: some seconds." }));
    try {
      const found = await ask("diagnose", { ...model, plans });
      const add = (text, effects, formulas) => {
        const button = element("button", { type: "button", textContent: text });
        button.addEventListener("click", () => go({ effects: [...model.effects, ...effects], formulas: [...model.formulas, ...formulas] }));
        return element("li", {}, button);
      };
      const parts = found.steps.flatMap((step) => step.map((name) => add(step.length > 1 ? `Add ${name}: one of ${step.length} that explain the same` : `Add ${name}`, [name], [])));
      parts.push(...found.formulas.map((one) => add(`Add ${one.formulas.join(" and ")}`, [], one.formulas)));
      const nothing = found.at_floor ? "Nothing is missing: the residual is noise." : "Neither the catalogue nor formulas explain what is left.";
      result.replaceChildren(
        element("p", { className: "note", textContent: [found.missing.trim(), found.headline].filter(Boolean).join(" ") }),
        parts.length ? element("ul", {}, ...parts) : element("p", { className: "note", textContent: nothing }),
      );
      if (found.plan) result.append(element("pre", { className: "command", textContent: found.plan }));
    } catch (error) {
      result.replaceChildren(element("p", { className: "note", textContent: error.message }));
    }
    for (const id of ["diagnose", "plan"]) at(id).disabled = false;
  }
  at("diagnose").addEventListener("click", () => diagnose(false));
  at("plan").addEventListener("click", () => diagnose(true));

  // The scatter follows the stretch that the plots over time show.
  let stretch, waiting;
  function follow() {
    clearTimeout(waiting);
    waiting = setTimeout(async () => {
      if (!stretch || !at("covariate").value) return;
      const model = shownModel;
      try {
        const { plot } = await ask("scatter", {
          choice: model,
          covariate: at("covariate").value,
          stretch: { ...stretch, axis: Number(at("scatter-axis").value) },
        });
        if (model === shownModel) at("scatter-plot").innerHTML = plot;
      } catch (error) {
        at("scatter-plot").textContent = error.message;
      }
    }, 150);
  }
  document.addEventListener("stretch", (event) => ((stretch = event.detail), follow()));
  for (const id of ["covariate", "scatter-axis"]) at(id).addEventListener("change", follow);

  at("undo").addEventListener("click", () => step(-1));
  at("redo").addEventListener("click", () => step(1));
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z" || event.target.matches("input")) return;
    event.preventDefault();
    step(event.shiftKey ? 1 : -1);
  });
  at("baseline").addEventListener("change", () => {
    chosen = at("baseline").value;
    show();
  });
  at("formula-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const text = at("formula").value.trim();
    if (!text) return;
    const { effects, formulas } = current();
    if (await go({ effects, formulas: [...formulas, text] })) at("formula").value = "";
  });
  const files = { model: "model.toml", tables: "tables.rs", report: "report.html" };
  at("write-kind").addEventListener("change", () => (at("write-path").value = files[at("write-kind").value]));
  at("write-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const other = at("baseline").value;
    const baseline = other ? JSON.parse(other) : undefined;
    const body = { ...current(), kind: at("write-kind").value, path: at("write-path").value };
    try {
      const done = await ask("write", { ...body, baseline: baseline && { effects: baseline[0], formulas: baseline[1] } });
      at("written").textContent = done.message;
    } catch (error) {
      at("written").textContent = error.message;
    }
  });

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
    const all = [...names.targets, ...names.covariates, ...names.functions];
    const found = part ? all.filter((name) => name.startsWith(part) && name !== part) : [];
    at("words").replaceChildren(...found.map((name) => element("option", { value: before.slice(0, start) + name + input.value.slice(end) })));
  }
  at("formula").addEventListener("input", suggest);

  ask("names", {}).then((found) => {
    names = found;
    at("covariate").replaceChildren(...found.residual_covariates.map(({ name, words }) => element("option", { value: name, textContent: words })));
    follow();
    for (const [heading, list] of [["Targets", names.targets], ["Covariates", names.covariates], ["Functions", names.functions]]) {
      at("names").append(element("h3", { textContent: heading }));
      for (const name of list) {
        const button = element("button", { type: "button", textContent: name });
        button.addEventListener("click", () => insert(name));
        at("names").append(button);
      }
    }
  });
  show();
}
