/* Last step: files, check, plan, forecast of the gates, and writing. */
import { make } from "./dom.js";
import { known, number, say } from "./language.js";
import { facts, table } from "./parts.js";
import { findingText, unchecked, wrongAxes } from "./setup-checks.js";
import { change, seen, send } from "./setup-state.js";
import { inPageWords, prose, sentences } from "./setup-words.js";

export function reviewPanel() {
  const box = make("div", { className: "content-parts" });
  let preparing = false;
  const prepare = async () => {
    [preparing, seen.refusal] = [true, null];
    update();
    await change("review", {}, (problem) => (seen.refusal = problem));
    preparing = false;
    update();
  };
  const update = () => {
    const { review, written } = seen.now;
    const act = preparing ? make("p", { role: "status" }, say("review.preparing"))
      : review ? null : make("div", { className: "acts" }, make("button", { id: "prepare", className: "big go", onclick: prepare }, say("review.prepare")));
    const why = seen.refusal ? problemPanel(sentences(seen.refusal.detail, seen.refusal.hint)) : null;
    box.replaceChildren(...[why, written ? writtenPart(written) : null, act, ...(review ? reviewParts(review, written) : [])].filter(Boolean));
  };
  return { element: box, update };
}

const problemPanel = (text) => make("div", { className: "panel problem", role: "alert" }, make("b", {}, say("review.refused")), make("p", {}, ...prose(inPageWords(text))));

function reviewParts(review, written) {
  const { summary } = review;
  const open = [...wrongAxes().map((axis) => `${axis}: ${findingText(axis, seen.now.axes[axis])}`), ...unchecked()];
  const pairs = [["plan.machine", summary.machine], ["plan.artefact", summary.artefact], ["plan.stations", String(summary.stations)],
    ["plan.position_set", summary.position_set.split("/").at(-1)], ["plan.touches", String(summary.touches_per_ball)],
    ...("balls" in review ? [["plan.balls", String(review.balls)], ["plan.minutes", `${number(review.machine_minutes, 0)} min`], ["plan.valuation", `${number(review.valuation_percent, 0)} %`]] : [])];
  return [
    make("p", { className: "result", "data-look": "good", id: "checked" }, say("review.check")),
    open.length ? make("div", { className: "panel" }, make("h2", {}, say("review.open")), make("ul", {}, ...open.map((text) => make("li", {}, text)))) : null,
    written ? null : make("div", { className: "acts" }, make("button", { id: "write", className: "big go", onclick: () => change("write") }, say("review.write"))),
    make("h2", {}, say("review.plan")),
    review.refused ? problemPanel(review.refused) : null,
    facts(pairs),
    ...review.preview.filter((name) => name.endsWith(".png")).map((name) => make("img", { className: "picture", src: `/api/setup/preview/${name}?${encodeURIComponent(review.preview_directory)}`, alt: say("review.picture") })),
    make("h2", {}, say("review.gates")), gates(review.gates),
    make("h2", {}, say("review.files")),
    make("div", { className: "files" }, ...Object.entries(review.texts).map(([name, text]) => make("details", {}, make("summary", {}, name), make("pre", { tabIndex: 0 }, make("code", {}, text)))),
      ...review.preview.map((name) => make("p", { className: "drawn" }, make("code", {}, `preview/${name}`)))),
    make("h2", {}, say("review.next")), commands(review.next),
  ].filter(Boolean);
}

const named = (gate) => gate.replaceAll(" ", "_");

function gates(list) {
  const heads = ["review.gate", "review.expected", "review.limit", "review.result", "review.key"].map((key) => say(key));
  return table(heads, list.map(({ gate, expected, comparison, limit, passes, key }) => [
    known(`gate.${named(gate)}`) ? say(`gate.${named(gate)}`) : gate, expected === null ? "∞" : number(expected, 3), `${comparison} ${number(limit, 3)}`,
    passes ? make("span", { className: "passes" }, `✓ ${say("review.passes")}`)
      : make("span", {}, make("span", { className: "fails" }, `✕ ${say("review.fails")}`), " ", ...prose(say(`remedy.${named(gate)}`))),
    make("code", {}, key)]));
}

const commands = (next) => make("pre", { className: "commands", tabIndex: 0 }, make("code", {}, next.join("\n")));

function writtenPart({ files, preview, next }) {
  const end = async () => {
    if (await send("finish")) {
      seen.finished = true;
      document.body.classList.add("finished");
      document.querySelector("#step").replaceChildren(make("p", { className: "result live", "data-look": "good", id: "finished" }, say("review.finished")), commands(next));
    }
  };
  return make("div", { className: "panel", id: "written" }, make("p", { className: "result live", "data-look": "good" }, say("review.written")),
    make("ul", {}, ...[...files, ...preview].map((file) => make("li", {}, make("code", {}, file)))), make("b", {}, say("review.next")), commands(next),
    make("div", { className: "acts" }, make("button", { id: "finish", className: "big go", onclick: end }, say("review.finish"))));
}
