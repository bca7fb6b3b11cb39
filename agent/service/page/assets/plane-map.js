/* Colour maps of a length over XY planes of the workspace, with their common scale. */
import { make } from "./dom.js";
import { number, say } from "./language.js";
import { colourOf, STOPS } from "./viridis.js";

/* Largest value of the planes; 1 if all are zero. */
const topOf = (planes) => Math.max(0, ...planes.flatMap(({ length_um }) => length_um.flat())) || 1;

export function planeMaps(planes) {
  const top = topOf(planes);
  return [make("div", { className: "planes" }, ...planes.map((plane) => figure(plane, top))), scale(top)];
}

function figure(plane, top) {
  const { length_um: rows, x_mm: x, y_mm: y, z_mm: z } = plane;
  const canvas = make("canvas", { width: rows[0].length, height: rows.length, role: "img" });
  canvas.setAttribute("aria-label", say("map.plane_name", { z: number(z, 0), largest: number(Math.max(...rows.flat()), 1) }));
  const context = canvas.getContext("2d"), image = context.createImageData(rows[0].length, rows.length);
  rows.forEach((row, j) => row.forEach((value, i) => {
    const at = 4 * ((rows.length - 1 - j) * row.length + i);
    image.data.set([...colourOf(value / top), 255], at);
  }));
  context.putImageData(image, 0, 0);
  canvas.style.aspectRatio = `${x[1] - x[0]} / ${y[1] - y[0]}`;
  return make("figure", {}, make("figcaption", {}, say("map.plane", { z: number(z, 0) })), canvas,
    make("div", { className: "ends" }, make("span", {}, say("map.x", { from: number(x[0], 0), to: number(x[1], 0) })),
      make("span", {}, say("map.y", { from: number(y[0], 0), to: number(y[1], 0) }))));
}

const micrometres = (value) => say("unit.um", { value: number(value, 1) });

/* The scale of maps from 0 to `top`, whose value `text` writes. */
export function scale(top, text = micrometres) {
  const bar = make("canvas", { width: 10 * STOPS, height: 1, ariaHidden: "true" });
  const context = bar.getContext("2d");
  for (let i = 0; i < bar.width; i++) {
    context.fillStyle = `rgb(${colourOf(i / (bar.width - 1)).join(" ")})`;
    context.fillRect(i, 0, 1, 1);
  }
  return make("div", { className: "scale" }, make("span", {}, number(0, 0)), bar, make("span", {}, text(top)));
}
