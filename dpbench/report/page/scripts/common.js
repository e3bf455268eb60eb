// What the pages share: unpacking the block of data, numbers as words, colours and tooltips.
"use strict";

const $ = (id) => document.getElementById(id);
const MISSING = 65535, GAP = -32768;
let facts, bytes, base;
const decoded = new Map();

async function unpack() {
  const packed = Uint8Array.from(atob($("block").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(bytes.buffer).getUint32(0, true);
  base = 4 + length;
  facts = JSON.parse(new TextDecoder().decode(bytes.subarray(4, base)));
}

// The numbers of one packed array; null where one is missing.
function array(index) {
  if (index === undefined || index === null) return [];
  if (decoded.has(index)) return decoded.get(index);
  const [kind, start, count, scale, places] = facts.arrays[index];
  const at = base + start, out = new Array(count);
  let before = 0;
  for (let i = 0; i < count; i++) {
    if (kind === "flag") { out[i] = bytes[at + i]; continue; }
    let code = bytes[at + i] | (bytes[at + count + i] << 8);
    if (kind === "place") { out[i] = before += code; continue; }
    if (kind !== "log") before = code = (before + code) & 65535;
    if (kind === "log") {
      out[i] = code === 0 ? null : code === 1 ? 0 : code === 65535 ? Infinity
        : 1e-16 * 10 ** ((code - 2) / 200);
    } else if (kind === "count") out[i] = code === MISSING ? null : code;
    else {
      const signed = code > 32767 ? code - 65536 : code;
      out[i] = signed === GAP ? null : signed * scale;
    }
  }
  const all = places === undefined ? out : spread(out, places, kind === "flag" ? 0 : null);
  decoded.set(index, all);
  return all;
}

// The long array of which some elements are there.
function spread(some, places, missing) {
  const all = new Array(facts.arrays[places][3]).fill(missing);
  array(places).forEach((j, i) => { all[j] = some[i]; });
  return all;
}

// A number as text that an input or an address takes.
function plain(x, digits = 3) {
  if (x === null || x === undefined) return "–";
  if (x === "inf" || x === Infinity) return "∞";
  return x !== 0 && (Math.abs(x) < 1e-3 || Math.abs(x) >= 1e7)
    ? Number(x).toExponential(Math.max(1, digits - 2)) : String(Number(Number(x).toPrecision(digits)));
}

// A number in three significant digits with its last zeros, as the texts of the report have it.
function significant(x) {
  const near = Number(Number(x).toPrecision(3));
  return near ? grouped(near.toFixed(Math.max(0, 2 - Math.floor(Math.log10(Math.abs(near)))))) : "0";
}

// A whole number, or that before the point, with thin spaces between thousands.
const grouped = (x) => String(x).replace(/^-?\d{4,}(?=\.|$)/, (whole) => whole.replace(/\B(?=(\d{3})+$)/g, "\u202f"));

// A number as text that is read.
const figure = (x, digits = 3) => grouped(plain(x, digits));

// A text as nodes, what Markdown marks as code as code; no line breaks before a unit.
const coded = (text) => text.replace(/(?<=\d) (?=(%|[nµm]?s|c?m)(?![\w/]))|(?<=×) (?=\d)/g, "\u00a0").split("`").map((part, i) => {
  if (i % 2 === 0) return part;
  const node = document.createElement("code");
  node.textContent = part;
  return node;
});

// So many of what has a plural in s.
const many = (x, word) => `${Number.isInteger(x) ? grouped(x) : figure(x)} ${word}${x === 1 ? "" : "s"}`;

// As `significant`, but never more than x: what still holds when it is believed.
function roundedDown(x) {
  const near = Number(x.toPrecision(3));
  return significant(near > x ? near - 10 ** (Math.floor(Math.log10(x)) - 2) : near);
}

// A canvas knows no variables of the style sheet: it gets the colours they have now.
function inked(spec) {
  const style = getComputedStyle(document.documentElement);
  return JSON.parse(JSON.stringify(spec).replace(/var\((--[\w-]+)\)/g,
    (_, name) => style.getPropertyValue(name).trim()));
}

// A tooltip of text alone; the grammar hands over rows of names and values.
function vegaTooltip() {
  const box = $("tip");
  return (_, event, __, value) => {
    if (!value) { box.hidden = true; return; }
    const known = Object.entries(value).filter(([, text]) => !["–", "null"].includes(String(text)));
    box.replaceChildren(...known.map(([name, text]) => {
      const row = document.createElement("div"), head = document.createElement("b");
      head.textContent = name; row.append(head, ` ${String(text).replaceAll("`", "")}`);
      return row;
    }));
    box.hidden = false;
    box.style.left = `${Math.min(event.pageX + 14, scrollX + innerWidth - box.offsetWidth - 8)}px`;
    const below = event.clientY + 14 + box.offsetHeight < innerHeight;
    box.style.top = `${event.pageY + (below ? 14 : -14 - box.offsetHeight)}px`;
  };
}

// Draws again when the colours or the width there is have changed.
function onNewLook(redraw) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  let width = innerWidth, waiting = null;
  addEventListener("resize", () => {
    if (innerWidth === width) return;
    width = innerWidth;
    clearTimeout(waiting);
    waiting = setTimeout(redraw, 200);
  });
}
