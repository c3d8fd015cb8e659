/* What the page holds, and how it is read. */
'use strict';

const ARRAYS = { f4: Float32Array, f8: Float64Array, i4: Int32Array, u2: Uint16Array, u4: Uint32Array };

const report = JSON.parse(document.getElementById('content').textContent);
const style = getComputedStyle(document.documentElement);
const colour = (name) => style.getPropertyValue(`--${name}`).trim();
const dark = matchMedia('(prefers-color-scheme: dark)');

function unpack({ dtype, bdata }) {
  const text = atob(bdata);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  return new ARRAYS[dtype](bytes.buffer);
}

function digits(value, unit) {
  if (!Number.isFinite(value)) return '–';
  const isPlain = value === 0 || (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e5);
  const text = isPlain ? `${Number(value.toPrecision(3))}` : value.toExponential(2);
  return `${text.replaceAll('-', '−')} ${unit}`.trim();
}
