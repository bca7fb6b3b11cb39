/* Colour map of the report: lightness increases evenly, so it is readable without colour vision and on paper. */
const TABLE = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37],
];
export const STOPS = TABLE.length;

/* Returns [red, green, blue] of a fraction 0…1. */
export function colourOf(share) {
  const place = Math.min(Math.max(share, 0), 1) * (STOPS - 1), from = Math.min(Math.floor(place), STOPS - 2);
  return TABLE[from].map((value, i) => Math.round(value + (place - from) * (TABLE[from + 1][i] - value)));
}
