// The camera's picture with the planned path on top.

const GOOD = '#4cc9f0', BAD = '#ff5a4f', TARGET = '#ffd166', GOAL = '#7ae582';

function outline(pen, corners) {
  if (corners.some((p) => p === null)) return;
  pen.beginPath();
  corners.forEach(([u, v], k) => (k ? pen.lineTo(u, v) : pen.moveTo(u, v)));
  pen.closePath();
  pen.stroke();
}

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    this.bitmap = null;
    this.size = null; // of the camera's image [px]; the picture may be smaller
    this.path = [];
    this.bad = new Set();
    this.target = null;
    this.showPath = true;
    this.frames = 0;
    this.seen = 0;
  }

  async take(blob) {
    const bitmap = await createImageBitmap(blob);
    if (this.bitmap) this.bitmap.close();
    this.bitmap = bitmap;
    this.frames += 1;
    this.seen = performance.now();
    this.draw();
  }

  draw() {
    const { canvas } = this;
    const [wide, high] = this.size || [640, 480];
    const shown = Math.max(1, Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)));
    const tall = Math.max(1, Math.round((shown * high) / wide));
    if (canvas.width !== shown || canvas.height !== tall) {
      canvas.width = shown;
      canvas.height = tall;
    }
    const pen = canvas.getContext('2d');
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, shown, tall);
    if (this.bitmap) pen.drawImage(this.bitmap, 0, 0, shown, tall);
    if (!this.showPath || !this.path.length) return;
    const scale = shown / wide;
    // The centre of the first pixel is (0, 0), so the picture begins at -0.5.
    pen.setTransform(scale, 0, 0, scale, 0.5 * scale, 0.5 * scale);
    this.drawPath(pen, 1 / scale * (window.devicePixelRatio || 1));
  }

  drawPath(pen, unit) {
    const { path } = this;
    const every = Math.max(1, Math.round(path.length / 10));
    pen.globalAlpha = 0.85;
    pen.lineWidth = 1.2 * unit;
    for (let corner = 0; corner < path[0].length; corner += 1) {
      for (let k = 1; k < path.length; k += 1) {
        const a = path[k - 1][corner], b = path[k][corner];
        if (!a || !b) continue;
        pen.strokeStyle = this.bad.has(k) || this.bad.has(k - 1) ? BAD : GOOD;
        pen.beginPath();
        pen.moveTo(...a);
        pen.lineTo(...b);
        pen.stroke();
      }
    }
    pen.globalAlpha = 0.45;
    path.forEach((corners, k) => {
      if (k % every && !this.bad.has(k)) return;
      pen.strokeStyle = this.bad.has(k) ? BAD : GOOD;
      outline(pen, corners);
    });
    pen.globalAlpha = 1;
    this.strong(pen, path[path.length - 1], GOAL, 2 * unit, [6 * unit, 4 * unit]);
    if (this.target !== null && path[this.target]) {
      this.strong(pen, path[this.target], TARGET, 2.2 * unit, []);
    }
  }

  strong(pen, corners, color, width, dash) {
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.setLineDash(dash);
    outline(pen, corners);
    pen.setLineDash([]);
  }
}
