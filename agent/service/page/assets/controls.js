/* Buttons of the footer and their keyboard shortcuts. */
import { accessText, onAccess } from "./access.js";
import { askAccess } from "./access-dialog.js";
import { askStart, showKeys } from "./dialogs.js";
import { byId } from "./dom.js";
import { inEnglish, onLanguage, say } from "./language.js";
import { ask, askFirst, isTokenRefused, read, Refused, token } from "./requests.js";
import { showDone, showProblem, showSent, showWarning } from "./notices.js";
import { on, refresh } from "./store.js";

const KEYS = [
  ["A", "request.abort"], ["S", "request.start"], ["H", "request.hold"], ["R", "request.resume"], ["Q", "request.reset"],
  ["1", "view.operator"], ["2", "view.engineer"], ["?", "keys.show"], ["Tab", "keys.tab"], ["← → ↑ ↓ + −", "keys.scene"],
];
const UNCONFIRMED_MS = 800;
const PRESSED = { a: "abort", s: "start", h: "hold", r: "resume", q: "reset", 1: "tab-operator", 2: "tab-engineer", "?": "keys" };

export function openControls() {
  byId("start").addEventListener("click", begin);
  byId("hold").addEventListener("click", () => request("/api/hold", {}, "done.hold"));
  byId("resume").addEventListener("click", () => request("/api/resume", {}, "done.resume"));
  byId("reset").addEventListener("click", () => request("/api/reset", {}, "done.reset"));
  byId("resume-run").addEventListener("click", () => request("/api/resume-run", { source: "page" }, "done.resume_run"));
  byId("abort").addEventListener("click", abort);
  byId("token").addEventListener("click", () => askAccess());
  const who = () => {
    const text = accessText();
    Object.assign(byId("token"), { textContent: text ?? say("access.enter"), title: text ?? "" });
  };
  onAccess(who);
  onLanguage(who);
  who();
  byId("keys").addEventListener("click", () => showKeys(KEYS));
  addEventListener("keydown", press);
  on("status", offer);
}

function offer({ may }) {
  const can = (what) => may.includes(what);
  byId("start").disabled = !can("start");
  byId("hold").disabled = !can("hold");
  byId("hold").hidden = can("resume");
  byId("resume").hidden = !can("resume");
  byId("reset").hidden = !can("reset");
  byId("resume-run").hidden = !can("resume_run");
}

/* Abort needs one press, no confirmation and no token; nothing else waits for its response. A service that hangs does
   not answer at all: then the emergency stop is the only way left, and the page says so without waiting for an error.
   The reason is sent in English, as all that is kept: each reader gets it in their own language. */
async function abort() {
  showSent("abort.sent");
  const silent = setTimeout(() => showWarning("abort.unconfirmed"), UNCONFIRMED_MS);
  try {
    await askFirst("/api/abort", { reason: inEnglish("abort.reason") });
    showDone("done.abort");
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    showWarning("abort.unconfirmed");
  } finally {
    clearTimeout(silent);
  }
}

async function begin() {
  try {
    const wanted = await askStart(await read("/api/machine"));
    if (wanted) await request("/api/start", wanted, "done.start", "start.sent");
  } catch (error) {
    showProblem(error);
  }
}

/* Sends a command with the token, and asks for one if it is missing or wrong. */
export async function request(path, body, done, sent = null) {
  if (!token() && !(await askAccess())) return false;
  if (sent) showSent(sent);
  try {
    await ask(path, body);
    showDone(done);
    await refresh();
    return true;
  } catch (error) {
    showProblem(error);
    if (isTokenRefused(error) && (await askAccess(say("access.refused")))) return request(path, body, done, sent);
    return false;
  }
}

/* Shortcuts are ignored while typing; while a dialog is open only abort is accepted. */
function press(event) {
  const id = PRESSED[event.key.toLowerCase()];
  if (!id || event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
  if (event.target.closest("select, textarea, input:not([type=checkbox], [type=radio])")) return;
  const button = byId(id);
  if (button.disabled || button.hidden || (byId("dialog").open && id !== "abort")) return;
  event.preventDefault();
  button.click();
}
