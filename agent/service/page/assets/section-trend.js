/* Section with the volumetric errors over the nights: without table, with the active table, held-out balls. */
import { make } from "./dom.js";
import { say } from "./language.js";
import { heading, remark } from "./parts.js";
import { read } from "./requests.js";
import { alarmList, keyOfLines, spans, trendFigure } from "./trend-figure.js";

export const ofRun = false;

export async function parts({ again }) {
  const { trends, alarms, marks } = await read("/api/page/trends");
  const shown = trends.filter(({ volumetric }) => volumetric);
  if (!shown.length) return [heading("trend.title"), remark("trend.none")];
  const zoomed = () => again({ quiet: true });
  return [heading("trend.title"), ...alarmList(alarms), spans(zoomed), remark("trend.zoom"),
    make("div", { className: "figures" }, ...shown.map((trend) => trendFigure(trend, say(`trend.${trend.name}`), marks, zoomed))), keyOfLines(marks)];
}
