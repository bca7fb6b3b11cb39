/* Section with the settings as the service has read them, beside those of a run, under the keys of the settings file. */
import { accessText, permits } from "./access.js";
import { askAccess } from "./access-dialog.js";
import { make } from "./dom.js";
import { say } from "./language.js";
import { choice, field, heading, remark, table } from "./parts.js";
import { read, token } from "./requests.js";

export const ofRun = true, needsEstimate = false, withoutRun = true;
const SHOWN = { stated: ({ stated }) => stated, all: () => true, differing: (row) => differs(row) };
const wanted = { shown: "stated", text: "" };

export async function parts({ run, again }) {
  const title = heading("settings.title");
  if (!token() || !permits("check_settings")) return [title, ...refused(again)];
  const { file, rows } = await read(`/api/page/settings${run ? `?run=${encodeURIComponent(run)}` : ""}`, { withToken: true });
  const shown = Object.keys(SHOWN).filter((name) => run || name !== "differing");
  const list = make("div", { className: "found" });
  const fill = () => list.replaceChildren(...found(rows, run));
  const search = make("input", { type: "search", id: "settings-text", value: wanted.text, oninput: () => {
    wanted.text = search.value;
    fill();
  } });
  fill();
  const chosen = (name) => {
    wanted.shown = name;
    return again({ quiet: true });
  };
  return [title, remark(run ? "settings.is" : "settings.is_alone", { file }), make("div", { className: "choosers" },
    field("settings.text", search), choice("settings.choose", shown.map((name) => [name, `settings.${name}`]), shown.includes(wanted.shown) ? wanted.shown : "stated", chosen)), list];
}

/* Who may not see them is told why, and can pair as somebody who may. */
function refused(again) {
  const pair = async () => (await askAccess()) && again();
  return [make("p", {}, accessText() === null ? say("settings.no_token") : say("settings.role", { who: accessText() })),
    make("div", { className: "acts" }, make("button", { id: "settings-pair", onclick: pair }, say("access.enter")))];
}

const text = (value) => (value === null || value === undefined ? "–" : typeof value === "object" ? JSON.stringify(value) : String(value));
const differs = ({ now, in_run: former }) => text(now) !== text(former);

function found(rows, run) {
  const words = wanted.text.toLowerCase(), kept = rows.filter(SHOWN[wanted.shown] ?? SHOWN.stated).filter(({ key }) => key.toLowerCase().includes(words));
  if (!kept.length) return [remark(wanted.shown === "differing" ? "settings.same" : "settings.none")];
  const heads = ["settings.key", "settings.now", ...(run ? ["settings.in_run"] : []), "settings.origin"];
  return [table(heads.map((key) => say(key)), kept.map((row) => [
    make("code", {}, row.key), text(row.now), ...(run ? [differs(row) ? make("b", { className: "differs" }, text(row.in_run)) : text(row.in_run)] : []),
    say(row.stated ? "settings.from_file" : "settings.default"),
  ]), "settings")];
}
