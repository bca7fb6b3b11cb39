/* Steps with the controller: what it reports, directions checked by jogging, and the first touch by finger. */
import { byId, make } from "./dom.js";
import { number, say } from "./language.js";
import { table } from "./parts.js";
import { drawChain } from "./setup-drawing.js";
import { shown } from "./setup-fields.js";
import { change, poll, seen, send } from "./setup-state.js";
import { prose } from "./setup-words.js";

const AXES = ["X", "Y", "Z"];
let jogged = "", touched = false;

/* Ends watching; called when a step is left. */
export function rest() {
  jogged = "";
  touched = false;
}

const panel = (...children) => make("div", { className: "panel" }, ...children);
const result = (look, text) => make("p", { className: "result", "data-look": look }, text);
const inStep = (id) => Boolean(byId(id));

export function connectPanel() {
  const box = panel(), update = () => {
    const { simulated, connected, reading, answers } = seen.now;
    const press = () => change("connect");
    const parts = simulated ? [make("p", {}, say("connect.simulated"))]
      : [make("p", { className: "result", "data-look": connected ? "good" : "" }, say(connected ? "connect.open" : "connect.closed")),
        make("div", { className: "acts" }, make("button", { id: "connect", onclick: press }, say(reading ? "connect.again" : "connect.read")))];
    if (reading) parts.push(readingTable(reading));
    box.replaceChildren(...parts);
    box.hidden = !answers.controller && !seen.now.proposals.controller && !simulated;
  };
  return { element: box, update };
}

function readingTable({ lower_mm, upper_mm, rapid_mm_per_min, acceleration_mm_per_s2 }) {
  const heads = ["reading.axis", "reading.travel", "reading.rapid", "reading.acceleration"].map((key) => say(key));
  return table(heads, AXES.map((axis, i) => [axis, `${shown(lower_mm[i])} … ${shown(upper_mm[i])}`, shown(rapid_mm_per_min[i]), shown(acceleration_mm_per_s2[i])]), "compact");
}

export function drawingPanel() {
  const box = make("div"), update = () => {
    const { chain, spindle } = seen.now.proposals;
    box.replaceChildren(...(chain ? [drawChain(chain, spindle, jogged), make("p", { className: "remark" }, say("drawing.arrows"))]
      : [make("p", { className: "remark" }, say("drawing.none"))]));
  };
  return { element: box, update };
}

export function jogPanel(redraw) {
  const box = panel(), live = make("div", { id: "jog" }), update = () => {
    const { connected, axes } = seen.now;
    const rows = AXES.map((axis) => result(axes[axis] ? (axes[axis].finding === "good" ? "good" : "wrong") : "", `${axis}: ${axes[axis] ? findingText(axis, axes[axis]) : say("jog.unchecked")}`));
    const press = (axis) => make("button", { id: `jog-${axis}`, ariaPressed: String(jogged === axis), onclick: () => begin(axis, live, redraw) }, say("jog.begin", { axis }));
    box.replaceChildren(make("h2", {}, say("jog.title")), ...rows,
      ...(connected ? [make("div", { className: "acts" }, ...AXES.map(press)), live] : [make("p", { className: "remark" }, ...prose(say("jog.offline")))]));
  };
  return { element: box, update };
}

export const findingText = (axis, { finding, moved, part }) =>
  say(`finding.${finding.replaceAll(" ", "_")}${finding === "wrong side" ? `_${part}` : ""}`, { axis, moved: moved.join(", ") });

async function begin(axis, live, redraw) {
  const first = await send("jog", { axis });
  if (!first) return;
  jogged = axis;
  live.replaceChildren(make("p", {}, say("jog.do", { axis })), make("p", { className: "live", id: "jog-live" }));
  redraw();
  await poll("look", () => jogged === axis && inStep("jog-live"), (look) => {
    if (look.asked !== axis) return;
    const moved = look.moved.length > 0;
    byId("jog-live").textContent = moved ? say("jog.moved", { axes: look.moved.join(", "), distance: number(look.distance_mm, 2) }) : say("jog.still");
    if (moved) askSeen(axis, look, live, redraw);
  });
}

/* Two questions about what the person saw; they stay while the axis moves on, and follow its sign. */
function askSeen(axis, { distance_mm }, live, redraw) {
  const signed = `${distance_mm < 0 ? "−" : "+"}${axis}`;
  const form = byId("jog-seen");
  if (form?.dataset.signed === signed) return;
  form?.remove();
  live.append(seenForm(axis, signed, redraw));
}

function seenForm(axis, signed, redraw) {
  const options = (name, values) => values.map(([value, key]) => make("label", { className: "check" },
    make("input", { type: "radio", name, value, required: true }), say(key, { signed })));
  const form = make("form", { id: "jog-seen", "data-signed": signed },
    make("fieldset", {}, make("legend", {}, say("jog.direction")), ...options("direction", [["as drawn", "jog.as_drawn"], ["opposite", "jog.opposite"], ["across", "jog.across"]])),
    make("fieldset", {}, make("legend", {}, say("jog.part")), ...options("part", [["tool", "jog.tool"], ["workpiece", "jog.workpiece"]])),
    make("button", { type: "submit", id: "jog-keep" }, say("jog.keep")));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const given = new FormData(form);
    if (!(await change("seen", { direction: given.get("direction"), part: given.get("part") }))) return;
    if (jogged === axis) jogged = "";
    byId("jog")?.replaceChildren();
    redraw();
  });
  return form;
}

export function fingerPanel() {
  const box = panel(), live = make("p", { className: "result live", id: "touch", role: "status" });
  const show = (finding) => {
    live.dataset.look = { good: "good", "always on": "wrong" }[finding] ?? "";
    live.textContent = say(`touch.${finding.replaceAll(" ", "_")}`);
  };
  const begin_ = async () => {
    const first = await send("touch");
    if (!first) return;
    show(first.finding);
    live.hidden = false;
    touched = true;
    await poll("probe", () => touched && inStep("touch"), ({ finding }) => {
      show(finding);
      if (finding === "good" && touched) {
        touched = false;
        change("touched", { by_hand: seen.now.probe.by_hand });
      }
    });
  };
  const update = () => {
    const { connected, probe } = seen.now;
    const tick = make("input", { type: "checkbox", id: "by-hand", checked: probe.by_hand, onchange: () => change("touched", { by_hand: tick.checked }) });
    if (!touched) {
      live.hidden = probe.finding === "waiting";
      if (live.hidden) live.textContent = "";
      else show(probe.finding);
    }
    box.replaceChildren(make("h2", {}, say("finger.title")), make("p", {}, say("finger.do")),
      ...(connected ? [make("div", { className: "acts" }, make("button", { id: "watch", onclick: begin_ }, say("finger.begin"))), live]
        : [make("p", { className: "remark" }, say("finger.offline"))]),
      make("label", { className: "check" }, tick, say("finger.by_hand")));
  };
  return { element: box, update };
}

/* What was not checked, in words. */
export function unchecked() {
  const { simulated, axes, probe } = seen.now;
  if (simulated) return [];
  const open = AXES.filter((axis) => !axes[axis]).map((axis) => say("review.open_axis", { axis }));
  return probe.finding === "good" || probe.by_hand ? open : [...open, say("review.open_probe")];
}

export const wrongAxes = () => AXES.filter((axis) => seen.now.axes[axis] && seen.now.axes[axis].finding !== "good");
