"use strict";
{
  const at = (id) => document.getElementById(id);
  const token = new URLSearchParams(location.search).get("token") ?? "";
  const form = at("form");
  const field = (name) => form.elements.namedItem(name);
  const value = (name) => field(name)?.value.trim() ?? "";
  // A JSON string is one of TOML, but for this character.
  const quote = (text) => JSON.stringify(text).replaceAll("\x7f", "\\u007f");
  const shell = (text) => (/^[\w./:@%+=,-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
  const decimal = (text) => (text !== "" && Number.isFinite(Number(text)) ? String(Number(text)) : quote(text));

  /** Name of the recording's column that a use of a source column becomes. */
  function target(use) {
    const to = use.querySelector(".to").value;
    if (to === "other") return use.querySelector(".other").value.trim();
    return use.querySelector(".unit").value === "lsb" ? to.replace(/_gauss$/, "_lsb") : to;
  }
  const uses = () => [...form.querySelectorAll(".use")].map((use) => ({ use, from: use.closest(".column").dataset.from, file: use.closest(".column").dataset.file, to: target(use) }));

  function table(side) {
    const key = (name) => value(`${side}.${name}`);
    const lines = ["", `[${side}]`];
    if (key("file")) lines.push(`file = ${quote(key("file"))}`);
    const clock = key("from") ? [`from = ${quote(key("from"))}`, `unit = ${quote(key("unit"))}`] : [`row_s = ${decimal(key("row_s"))}`];
    if (key("offset_s")) clock.push(`offset_s = ${decimal(key("offset_s"))}`);
    if (field(`${side}.from_first_row`).checked) clock.push("from_first_row = true");
    lines.push(`clock = { ${clock.join(", ")} }`, "columns = [");
    const own = uses().filter(({ to }) => to && (side === "force") === /^f\d+_/.test(to));
    for (const { use, from, to } of own.filter((one) => !one.to.startsWith("attitude."))) {
      const at = (name) => use.querySelector(name).value.trim();
      const scale = Number(at(".factor")) === 1 ? "" : `, scale = ${decimal(at(".factor"))}`;
      const missing = side === "force" && at(".code") ? `, missing = ${decimal(at(".code"))}` : "";
      lines.push(`  { from = ${quote(from)}, unit = ${quote(at(".unit"))}, to = ${quote(to)}${scale}${missing} },`);
    }
    lines.push("]");
    const parts = own.filter(({ to }) => to.startsWith("attitude."));
    if (parts.length) lines.push(`attitude = { ${parts.map(({ from, to }) => `${to.slice(9)} = ${quote(from)}`).join(", ")} }`);
    return lines;
  }

  const isKnown = () => value("geometry") === "known";
  const DIMENSIONS = { cylinder: ["diameter_mm", "length_mm"], tube: ["diameter_mm", "hole_mm", "length_mm"], cube: ["side_mm"], sphere: ["diameter_mm"] };

  /** The text of the mapping file. */
  function mapping() {
    const given = (names) => names.filter((name) => value(name)).map((name) => `${name} = ${decimal(value(name))}`);
    const lines = [`description = ${quote(value("description"))}`, `one_clock = ${value("times") === "one_clock"}`];
    if (value("times") === "stated") lines.push(`starts_s = [${value("starts_s").split(/[\s,;]+/).filter(Boolean).map(decimal).join(", ")}]`);
    lines.push(...given(["range_gauss", "gauss_per_lsb"]), ...table("hall"), ...table("force"));
    if (!isKnown()) return `${lines.join("\n")}\n`;
    const words = ["axis", "body_axis"].filter((name) => value(name)).map((name) => `${name} = ${quote(value(name))}`);
    const magnet = [`shape = ${quote(value("shape"))}`, ...given([...DIMENSIONS[value("shape")], "remanence_t"]), ...words];
    lines.push("", "[design]", ...given(["gap_mm", "stiffness_x_n_per_mm", "stiffness_z_n_per_mm", "force_range_n"]), `magnet = { ${magnet.join(", ")} }`, value("more"));
    return `${lines.join("\n")}\n`;
  }

  /** Shows what belongs to the choices, and what they make. A hidden field is not required. */
  function update() {
    const show = (one, is_shown) => {
      one.hidden = !is_shown;
      for (const input of one.querySelectorAll("input,select")) input.disabled = !is_shown;
    };
    const clocks = ["hall", "force"].map((side) => value(`${side}.from`));
    for (const { use, from, to } of uses()) {
      const choice = use.querySelector(".to"), unit = use.querySelector(".unit");
      const of = choice.selectedOptions[0].dataset.of ?? to.split("_").pop();
      const is_number = to !== "" && !to.startsWith("attitude.");
      show(use.querySelector(".name"), choice.value === "other");
      for (const one of use.querySelectorAll(".of-use")) show(one, is_number || choice.value === "other");
      show(use.querySelector(".missing"), /^f\d+_/.test(to));
      for (const option of unit.options) {
        const own = option.dataset.of;
        option.hidden = option.disabled = own !== undefined && choice.value !== "" && own !== of && !(of === "c" && own === "k") && !(of === "gauss" && own === "lsb");
      }
      if (unit.selectedOptions[0]?.disabled) unit.value = "";
      use.closest(".column").querySelector(".tag").textContent = clocks.includes(from) ? ", a clock" : "";
    }
    for (const side of ["hall", "force"]) {
      const has_column = value(`${side}.from`) !== "";
      show(field(`${side}.unit`).parentElement, has_column);
      show(field(`${side}.row_s`).parentElement, !has_column);
    }
    show(field("starts_s").parentElement, value("times") === "stated");
    show(field("gauss_per_lsb").parentElement, uses().some(({ to }) => to.endsWith("_lsb")));
    show(at("geometry"), isKnown());
    if (isKnown()) for (const name of ["diameter_mm", "hole_mm", "length_mm", "side_mm"]) show(field(name).parentElement, DIMENSIONS[value("shape")].includes(name));
    const text = mapping(), [file, campaign] = [value("mapping"), value("campaign")].map(shell), sources = at("commands").dataset.sources;
    at("text").textContent = text;
    at("commands").textContent = [
      `cargo magpie import --guess ${sources} -o ${file}    # then correct it as shown below`,
      `cargo magpie import ${file} ${sources} -o ${campaign}`,
      `cargo magpie fit ${campaign}${isKnown() ? "" : " --base polynomial"} -o base.toml`,
    ].join("\n");
    return text;
  }

  /** Marks the fields of what an error names: a column of a recording or of a source, a key, an output. */
  function mark(text) {
    const output = ["campaign", "mapping"].find((name) => text.startsWith(`${value(name)}: `));
    const column = output ?? /, column (.+?): /.exec(text)?.[1];
    if (!column) return;
    const key = column.split(".").pop();
    const own = uses().filter(({ to, from }) => to === column || (from === column && to)).map(({ use }) => use);
    own.push(...form.querySelectorAll(`[data-column="${CSS.escape(key)}"]`));
    own.push(...["hall", "force"].filter((side) => value(`${side}.from`) === column).map((side) => form.querySelector(`[data-side=${side}]`)));
    if (field(key)) own.push(field(key).parentElement ?? field(key));
    for (const one of own) {
      one.classList.add("wrong");
      one.append(Object.assign(document.createElement("p"), { className: "here", textContent: text.slice(text.indexOf(": ") + 2) }));
    }
  }

  async function send(event) {
    event.preventDefault();
    for (const one of form.querySelectorAll(".wrong")) one.classList.remove("wrong");
    for (const one of form.querySelectorAll(".here")) one.remove();
    at("error").textContent = "";
    at("result").hidden = true;
    const text = update();
    if (!form.reportValidity()) return;
    at("import").disabled = true;
    at("progress").textContent = "Importing: some seconds.";
    try {
      const answer = await fetch("import", {
        method: "POST",
        headers: { "content-type": "application/json", "x-token": token },
        body: JSON.stringify({ text, mapping: value("mapping"), campaign: value("campaign") }),
      });
      const content = await answer.text(), found = content.startsWith("{") ? JSON.parse(content) : { error: content };
      if (!answer.ok) {
        at("error").textContent = found.error;
        mark(found.error);
        if (found.error.startsWith(`${value("mapping")}, line`)) at("text").parentElement.open = true;
        return at("error").scrollIntoView({ block: "center" });
      }
      at("notes").replaceChildren(...found.notes.map((note) => Object.assign(document.createElement("li"), { textContent: note })));
      found.notes.forEach(mark);
      at("imported").textContent = found.text;
      at("result").hidden = false;
      at("open").hidden = found.is_refused;
      form.hidden = !found.is_refused;
      [field("campaign").value, field("mapping").value] = found.next;
      update();
      if (!found.is_refused && !found.notes.length) return location.reload();
      at("result").scrollIntoView({ block: "center" });
    } catch (error) {
      at("error").textContent = error.message;
    } finally {
      at("import").disabled = false;
      at("progress").textContent = "";
    }
  }

  if (form) {
    form.addEventListener("input", update);
    form.addEventListener("submit", send);
    form.addEventListener("click", ({ target }) => {
      if (!target.matches(".again")) return;
      const last = target.previousElementSibling, another = last.cloneNode(true);
      another.querySelector(".to").value = "";
      last.after(another);
      update();
    });
    // The mapping file has the name of its campaign until it gets one of its own.
    let named = value("campaign");
    field("campaign").addEventListener("input", () => {
      if (value("mapping") === `${named}.mapping.toml`) field("mapping").value = `${value("campaign")}.mapping.toml`;
      named = value("campaign");
    });
    at("open").addEventListener("click", () => location.reload());
    update();
  }
}
