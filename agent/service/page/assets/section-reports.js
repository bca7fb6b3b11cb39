/* Section with the reports of all runs as files, and the diagnostics archive for support. */
import { permits } from "./access.js";
import { askAccess } from "./access-dialog.js";
import { make } from "./dom.js";
import { instant, languageNow, number, say } from "./language.js";
import { beforeAfter, heading, micrometres, remark, table, wordOr } from "./parts.js";
import { fetchFile, isTokenRefused, token } from "./requests.js";
import { showProblem } from "./notices.js";
import { verdictMark } from "./wording.js";

export const ofRun = false;

export async function parts({ runs }) {
  const list = runs.length ? table(["reports.run", "reports.kind", "reports.state", "fact.ve_before", "fact.ve_now", "fact.held_out", "fact.balls", "fact.minutes", "reports.report"].map((key) => say(key)), runs.map(row)) : remark("section.no_run");
  const archive = permits("diagnostics") ? [make("div", { className: "acts" }, make("button", { id: "diagnostics", onclick: diagnostics }, say("reports.diagnostics"))), remark("reports.diagnostics_is")] : [];
  return [heading("reports.title"), ...archive, list];
}

function row({ run_id, kind, started, verdict, reason, balls, ended, ve_um, vce_um, held_out_before_um, held_out_after_um, machine_minutes }) {
  const link = (form) => make("a", { className: "button", href: `/api/page/runs/${encodeURIComponent(run_id)}/report.${form}?language=${languageNow()}`, download: "" }, say(`reports.${form}`));
  return [instant(started), wordOr("kind", kind), make("span", { title: reason ?? "" }, verdictMark(verdict)), micrometres(ve_um), micrometres(vce_um),
    beforeAfter(held_out_before_um, held_out_after_um), number(balls, 0), number(machine_minutes, 1),
    make("span", { className: "acts" }, ...(ended ? [link("html"), link("pdf")] : [say("reports.going_on")]))];
}

/* The archive contains everything known about the machine, so it requires a token: a request instead of a link. */
async function diagnostics() {
  if (!token() && !(await askAccess())) return;
  try {
    const address = URL.createObjectURL(await fetchFile("/api/diagnostics"));
    const link = make("a", { href: address, download: "volcal-diagnostics.zip" });
    link.click();
    URL.revokeObjectURL(address);
  } catch (error) {
    showProblem(error);
    if (isTokenRefused(error) && (await askAccess(say("access.refused")))) await diagnostics();
  }
}
