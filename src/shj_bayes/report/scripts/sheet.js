/* Axes and lines on a canvas, and the few things that all scripts of a page share. */
"use strict";
const EDGE = { left: 62, right: 12, top: 10, bottom: 44 };

const el = (tag, attributes = {}, ...children) => {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== false) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children);
  return node;
};
const STYLE = getComputedStyle(document.documentElement);
/* Live: the same call answers in light or dark. */
const colour = (name) => STYLE.getPropertyValue(name).trim();

const saveAs = (name, text) => {
  /* The mark in front makes spreadsheets read UTF-8. */
  const link = el("a", { download: `${name}.csv`, href: URL.createObjectURL(new Blob([`\ufeff${text}`], { type: "text/csv" })) });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
};

/* Round steps of an axis: 1, 2 or 5 times a power of ten, about one per `room` pixels. */
const ticks = (low, high, pixels, room) => {
  const rough = ((high - low) * room) / pixels;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const out = [];
  for (let i = Math.ceil(low / step); i * step <= high; i += 1) out.push(i * step);
  return { out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
};

class Sheet {
  constructor(canvas, xTitle, yTitle) {
    Object.assign(this, { canvas, xTitle, yTitle, pen: canvas.getContext("2d") });
  }

  begin([x0, x1], [y0, y1]) {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    Object.assign(this, { width, height, x0, x1, y0, y1 });
    this.wide = width - EDGE.left - EDGE.right;
    this.high = height - EDGE.top - EDGE.bottom;
    const pen = this.pen;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "13px system-ui, sans-serif";
    pen.lineWidth = 1;
    const along = ticks(x0, x1, this.wide, 75);
    const up = ticks(y0, y1, this.high, this.high < 200 ? 18 : 45);
    pen.strokeStyle = colour("--line");
    pen.fillStyle = colour("--ink");
    pen.textAlign = "center";
    for (const x of along.out) {
      this.rule(this.px(x), EDGE.top, this.px(x), EDGE.top + this.high);
      pen.fillText(x.toFixed(along.digits).replace("-", "−"), this.px(x), EDGE.top + this.high + 17);
    }
    pen.textAlign = "right";
    for (const y of up.out) {
      this.rule(EDGE.left, this.py(y), EDGE.left + this.wide, this.py(y));
      pen.fillText(y.toFixed(up.digits).replace("-", "−"), EDGE.left - 7, this.py(y) + 4);
    }
    pen.textAlign = "center";
    pen.fillText(this.xTitle, EDGE.left + this.wide / 2, height - 6);
    pen.save();
    pen.rotate(-Math.PI / 2);
    pen.fillText(this.yTitle, -(EDGE.top + this.high / 2), 14);
    pen.restore();
  }

  rule(a, b, c, d) {
    this.pen.beginPath();
    this.pen.moveTo(a, b);
    this.pen.lineTo(c, d);
    this.pen.stroke();
  }

  px(x) { return EDGE.left + ((x - this.x0) / (this.x1 - this.x0)) * this.wide; }
  py(y) { return EDGE.top + ((this.y1 - y) / (this.y1 - this.y0)) * this.high; }
  x(px) { return this.x0 + ((px - EDGE.left) / this.wide) * (this.x1 - this.x0); }
  y(py) { return this.y1 - ((py - EDGE.top) / this.high) * (this.y1 - this.y0); }

  /* Draw inside the axes only, between two places across the sheet (0 left, 1 right). */
  inside(draw, from = 0, to = 1) {
    const pen = this.pen;
    pen.save();
    pen.beginPath();
    pen.rect(EDGE.left + from * this.wide, EDGE.top, (to - from) * this.wide, this.high);
    pen.clip();
    draw(pen);
    pen.restore();
  }

  line(xs, ys, a, b, style, width = 1.6, dash = []) {
    const pen = this.pen;
    pen.beginPath();
    for (let i = a; i < b; i += 1) pen.lineTo(this.px(xs[i]), this.py(ys[i]));
    Object.assign(pen, { strokeStyle: style, lineWidth: width });
    pen.setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
  }

  dots(xs, ys, a, b, style) {
    this.pen.fillStyle = style;
    for (let i = a; i < b; i += 1) this.pen.fillRect(this.px(xs[i]) - 1.2, this.py(ys[i]) - 1.2, 2.4, 2.4);
  }

  ribbon(xs, lows, highs, a, b, style) {
    const pen = this.pen;
    pen.beginPath();
    for (let i = a; i < b - 1; i += 1) {
      pen.moveTo(this.px(xs[i]), this.py(lows[i]));
      pen.lineTo(this.px(xs[i]), this.py(highs[i]));
      pen.lineTo(this.px(xs[i + 1]), this.py(highs[i + 1]));
      pen.lineTo(this.px(xs[i + 1]), this.py(lows[i + 1]));
      pen.closePath();
    }
    pen.fillStyle = style;
    pen.fill();
  }
}
