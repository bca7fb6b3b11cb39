/* Section with the compensation tables: active bank, stored tables, difference of two, download, restoration. */
import { permits } from "./access.js";
import { request } from "./controls.js";
import { askConfirmation } from "./dialogs.js";
import { make } from "./dom.js";
import { instant, number, say } from "./language.js";
import { facts, heading, mark, remark, table, tableDifference } from "./parts.js";
import { read, Refused } from "./requests.js";
import { told } from "./sentences.js";
import { seen } from "./store.js";

export const ofRun = false;
const DETAILED = 12;
const compared = { one: null, other: null };

export async function parts({ again }) {
  const { active_bank: active, written_not_active: waiting, kept } = await read("/api/tables");
  if (!kept.length) return [heading("tables.title"), remark("tables.none")];
  const accepted = await acceptedRuns(kept);
  const acting = kept.find(({ bank, role }) => bank === active && role !== "backup") ?? kept.find(({ bank }) => bank === active);
  const rows = kept.map((row) => ({ ...row, id: `${row.run_id} ${row.role}`, acting: row === acting, accepted: row.role === "staged" && accepted.has(row.run_id), waiting: row.role === "staged" && row.bank === waiting }));
  return [
    heading("tables.title"),
    facts([["tables.active_bank", active === null ? "–" : number(active, 0)], ["tables.checksum", acting?.crc32 ?? "–"],
      ...(waiting === null ? [] : [["tables.waiting", number(waiting, 0)]])]),
    remark("tables.words"),
    table(["tables.when", "tables.what", "tables.bank", "tables.checksum", "tables.do"].map((key) => say(key)), rows.map((row) => cells(row, again)), "kept"),
    make("h3", {}, say("tables.compare")),
    await comparison(rows, again),
  ];
}

async function acceptedRuns(kept) {
  const runs = [...new Set(kept.map(({ run_id }) => run_id))].slice(0, DETAILED);
  const details = await Promise.all(runs.map((run) => read(`/api/runs/${encodeURIComponent(run)}`)));
  return new Set(details.filter(({ accepted }) => accepted).map(({ run_id }) => run_id));
}

function cells(row, again) {
  const { run_id, at, role, bank, crc32, shape } = row;
  const words = [mark(role), ...(row.waiting ? [mark("waiting")] : []), ...(row.acting ? [mark("active")] : []), ...(row.accepted ? [mark("accepted")] : [])];
  const save = crc32 ? make("a", { className: "button", href: `/api/page/tables/${encodeURIComponent(run_id)}/${role}.csv`, download: "" }, say("tables.save")) : null;
  const can = (seen.status?.may ?? []).includes("start");
  const back = !permits("restore_table") ? null : make("button", { className: "restore", disabled: !can, onclick: () => restore(row).then(() => again({ quiet: true })) }, say("tables.restore"));
  return [instant(at), make("span", { className: "marks" }, ...words), number(bank, 0), make("span", { title: shape ? shape.join(" × ") : "" }, crc32 ?? say("tables.empty")),
    make("span", { className: "acts" }, save, back)];
}

async function restore({ run_id, role, crc32, at }) {
  const which = say("tables.which", { role: say(`table.${role}`), at: instant(at), checksum: crc32 ?? say("tables.empty") });
  const sure = await askConfirmation(say("tables.restore_title"), `${which} ${say("tables.restore_is")}`, say("tables.restore_confirm"));
  if (sure) await request("/api/tables/restore", { run_id, role, source: "page" }, "done.restore");
}

async function comparison(rows, again) {
  const ids = rows.map(({ id }) => id);
  if (!ids.includes(compared.one)) compared.one = ids[Math.min(1, ids.length - 1)];
  if (!ids.includes(compared.other)) compared.other = ids[0];
  const chooser = (side) => make("label", {}, say(`tables.${side}`), make("select", {
    id: `compare-${side}`, onchange: (event) => {
      compared[side] = event.target.value;
      again({ quiet: true });
    },
  }, ...rows.map((row) => make("option", { value: row.id, selected: row.id === compared[side] }, `${instant(row.at)} · ${say(`table.${row.role}`)} · ${row.crc32 ?? say("tables.empty")}`))));
  const query = Object.entries(compared).map(([side, id]) => [side, ...id.split(" ")]).map(([side, run, role]) => `${side}=${encodeURIComponent(run)}&${side}_role=${role}`).join("&");
  const choosers = make("div", { className: "choosers" }, chooser("one"), chooser("other"));
  try {
    return make("div", {}, choosers, tableDifference(await read(`/api/page/tables/difference?${query}`)));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    return make("div", {}, choosers, make("p", { className: "remark" }, told(error.problem.detail)));
  }
}
