/* Section with all machines that share the history database, those that need attention first. */
import { make } from "./dom.js";
import { minute, number, say } from "./language.js";
import { heading, pager, remark, table, wordOr } from "./parts.js";
import { read } from "./requests.js";
import { verdictMark } from "./wording.js";

export const ofRun = false;
const PAGE = 50;
let offset = 0;

export async function parts({ again }) {
  const { machine: own, machines, total } = await read(`/api/history/plant?limit=${PAGE}&offset=${offset}`);
  if (!total) return [heading("plant.title"), remark("plant.none")];
  const heads = ["machine", "last", "days", "kind", "result", "ve", "held_out", "drift"].map((key) => say(`plant.${key}`));
  const go = (to) => {
    offset = to;
    return again({ quiet: true });
  };
  return [heading("plant.title"), remark(total > 1 ? "plant.is" : "plant.one"), table(heads, machines.map((one) => row(one, own)), "plant"), pager(offset, PAGE, total, go)];
}

function row({ machine, kind, started, days, verdict, ve_um, vce_um, held_out_um, drift_um_a_night: drift, drift_expanded_uncertainty: doubt, significant, dated_ahead: ahead }, own) {
  const rate = drift === null ? say("trend.too_few") : significant ? say("plant.rate", { drift: number(drift, 3), doubt: number(doubt, 3) }) : say("plant.no_drift", { doubt: number(doubt, 3) });
  const name = machine === own ? make("b", {}, machine) : machine;
  const named = ahead.length ? make("div", {}, name, make("br"), make("small", {}, say("plant.ahead", { run: ahead[ahead.length - 1] }))) : name;
  return [named, minute(started), number(days, 1), wordOr("kind", kind), verdictMark(verdict),
    `${number(ve_um, 2)} → ${number(vce_um, 2)}`, number(held_out_um, 2), rate];
}
