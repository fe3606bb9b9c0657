// A small plot of curves over time, newest at the right. Gaps stay gaps.

export const COLORS = ['#0072b2', '#e69f00', '#009e73', '#d55e00', '#cc79a7', '#56b4e9'];
const STEPS = [1, 2, 5, 10];
const SECONDS = [1, 2, 5, 10, 15, 20, 30, 60, 120, 180];

function niceStep(span, count) {
  const raw = Math.max(span, 1e-9) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * STEPS.find((s) => s * power >= raw * 0.999);
}

export function range(values, fromZero) {
  let low = fromZero ? 0 : Infinity, high = -Infinity;
  for (const v of values) {
    if (v === null) continue;
    low = Math.min(low, v);
    high = Math.max(high, v);
  }
  if (!(high >= low)) return [0, 1];
  const room = Math.max(0.06 * (high - low), fromZero ? 1e-3 : 0.5);
  return [fromZero ? low : low - room, high + room];
}

export class Plot {
  constructor(canvas, { fromZero = false } = {}) {
    this.canvas = canvas;
    this.fromZero = fromZero;
  }

  // times: seconds, ascending; curves: arrays of numbers or null; span: seconds shown
  draw(times, curves, span) {
    const { canvas } = this;
    const scale = window.devicePixelRatio || 1;
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w || !h) return;
    if (canvas.width !== Math.round(w * scale) || canvas.height !== Math.round(h * scale)) {
      canvas.width = Math.round(w * scale);
      canvas.height = Math.round(h * scale);
    }
    const style = getComputedStyle(document.documentElement);
    const pen = canvas.getContext('2d');
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = '11px system-ui, "DejaVu Sans", sans-serif';
    const box = { left: 44, right: w - 6, top: 6, bottom: h - 18 };
    const last = times.length ? times[times.length - 1] : 0;
    const [low, high] = range(curves.flat(), this.fromZero);
    const x = (t) => box.right + ((t - last) / span) * (box.right - box.left);
    const y = (v) => box.bottom - ((v - low) / (high - low)) * (box.bottom - box.top);
    this.grid(pen, box, { x, y, low, high, span, last,
      soft: style.getPropertyValue('--soft'), line: style.getPropertyValue('--line') });
    pen.save();
    pen.beginPath();
    pen.rect(box.left, box.top - 2, box.right - box.left + 2, box.bottom - box.top + 4);
    pen.clip();
    curves.forEach((curve, k) => this.curve(pen, times, curve, x, y, COLORS[k % COLORS.length]));
    pen.restore();
    if (!curves.some((curve) => curve.some((v) => v !== null))) {
      pen.fillStyle = style.getPropertyValue('--soft');
      pen.textAlign = 'center';
      pen.fillText('nothing measured yet', (box.left + box.right) / 2, (box.top + box.bottom) / 2);
    }
  }

  grid(pen, box, { x, y, low, high, span, last, soft, line }) {
    pen.lineWidth = 1;
    pen.strokeStyle = line;
    pen.fillStyle = soft;
    pen.textBaseline = 'middle';
    pen.textAlign = 'right';
    const step = niceStep(high - low, 3);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    pen.beginPath();
    for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) {
      pen.moveTo(box.left, y(v));
      pen.lineTo(box.right, y(v));
      pen.fillText(v.toFixed(digits).replace('-', '\u2212'), box.left - 6, y(v));
    }
    pen.textBaseline = 'top';
    pen.textAlign = 'center';
    const tick = SECONDS.find((s) => 4.5 * s >= span) || SECONDS[SECONDS.length - 1];
    for (let s = 0; s < span - 1e-9; s += tick) {
      pen.moveTo(x(last - s), box.top);
      pen.lineTo(x(last - s), box.bottom);
      pen.textAlign = s ? 'center' : 'right';
      pen.fillText(s ? `\u2212${s} s` : 'now', x(last - s), box.bottom + 5);
    }
    pen.stroke();
  }

  curve(pen, times, curve, x, y, color) {
    pen.strokeStyle = color;
    pen.lineWidth = 1.8;
    pen.lineJoin = 'round';
    pen.beginPath();
    let open = false;
    for (let k = 0; k < times.length; k += 1) {
      if (curve[k] === null || curve[k] === undefined) {
        open = false;
      } else if (open) {
        pen.lineTo(x(times[k]), y(curve[k]));
      } else {
        pen.moveTo(x(times[k]), y(curve[k]));
        open = true;
      }
    }
    pen.stroke();
  }
}
