/* Colour maps of one plane of the error field side by side on one scale. Pointer, finger or arrow keys choose a place, which is
   marked in all of them; its values are told in words. */
import { make } from "./dom.js";
import { number, say } from "./language.js";
import { colourOf } from "./viridis.js";

const WIDTH = 640, TALLEST = 480, NEAR_SHARE = 1 / 8;
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/* Expected length: of the vector and of what is not known of it. */
export const lengthOf = (vector, sigma) => Math.hypot(...vector, sigma);

/* One map of a plane. `rows`: values in µm, one row per position along the second axis; `chosen` is called with the column
   and the row of the place that was chosen. */
export class FieldMap {
  constructor(title, plane, rows, top, chosen) {
    const [a, b] = plane.across, [from, to] = [plane.ranges_mm[a], plane.ranges_mm[b]];
    const ratio = (to[1] - to[0]) / (from[1] - from[0]);
    const width = Math.round(Math.min(WIDTH, TALLEST / ratio));
    Object.assign(this, { plane, rows, place: null, columns: rows[0].length, from, to });
    this.canvas = make("canvas", { width, height: Math.round(width * ratio), role: "img", tabIndex: 0 });
    this.canvas.style.maxWidth = `calc(46vh / ${ratio})`;
    const largest = number(Math.max(...rows.flat()), 1);
    this.canvas.setAttribute("aria-label", say("field.map_name", { title, largest }));
    this.image = imageOf(rows, top);
    const pointed = (event) => {
      const { left, top: above, width: wide, height: high } = this.canvas.getBoundingClientRect();
      chosen(this.column((event.clientX - left) / wide), this.row(1 - (event.clientY - above) / high));
    };
    this.canvas.addEventListener("pointerdown", pointed);
    this.canvas.addEventListener("pointermove", pointed);
    this.canvas.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (!step || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      const [column, row] = this.place ?? [Math.floor(this.columns / 2), Math.floor(rows.length / 2)];
      chosen(clamp(column + step[0], this.columns), clamp(row + step[1], rows.length));
    });
    this.figure = make("figure", {}, make("figcaption", {}, title), this.canvas, make("div", { className: "ends" },
      make("span", {}, say("field.across", { axis: a, from: number(from[0], 0), to: number(from[1], 0) })),
      make("span", {}, say("field.up", { axis: b, from: number(to[0], 0), to: number(to[1], 0) }))));
    this.paint();
  }

  column(share) {
    return clamp(Math.round(share * (this.columns - 1)), this.columns);
  }

  row(share) {
    return clamp(Math.round(share * (this.rows.length - 1)), this.rows.length);
  }

  mark(place) {
    this.place = place;
    this.paint();
  }

  paint() {
    const { canvas, image, plane, from, to } = this, context = canvas.getContext("2d");
    const x = (share) => share * canvas.width, y = (share) => (1 - share) * canvas.height;
    context.drawImage(image, 0, 0, canvas.width, canvas.height);
    const near = nearOf(plane);
    for (const [u, v, away] of plane.measured) {
      const size = away <= near ? 4 : 2;
      dot(context, x((u - from[0]) / (from[1] - from[0])), y((v - to[0]) / (to[1] - to[0])), size);
    }
    if (this.place) cross(context, x(this.place[0] / (this.columns - 1)), y(this.place[1] / (this.rows.length - 1)));
  }
}

/* Balls nearer to the plane than this are drawn large, mm. */
export const nearOf = ({ ranges_mm: ranges, normal }) => NEAR_SHARE * (ranges[normal][1] - ranges[normal][0]);

const clamp = (value, count) => Math.min(Math.max(value, 0), count - 1);

function imageOf(rows, top) {
  const canvas = make("canvas", { width: rows[0].length, height: rows.length }), context = canvas.getContext("2d");
  const image = context.createImageData(canvas.width, canvas.height);
  rows.forEach((row, j) => row.forEach((value, i) => image.data.set([...colourOf(value / top), 255], 4 * ((rows.length - 1 - j) * row.length + i))));
  context.putImageData(image, 0, 0);
  return canvas;
}

/* White on black: seen on each colour of the scale. */
function dot(context, x, y, size) {
  context.beginPath();
  context.arc(x, y, size, 0, 2 * Math.PI);
  context.fillStyle = "#fff";
  context.fill();
  context.lineWidth = 1.2;
  context.strokeStyle = "#000";
  context.stroke();
}

function cross(context, x, y) {
  for (const [colour, width] of [["#000", 4], ["#fff", 1.8]]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.beginPath();
    context.moveTo(x - 14, y);
    context.lineTo(x + 14, y);
    context.moveTo(x, y - 14);
    context.lineTo(x, y + 14);
    context.stroke();
  }
}
