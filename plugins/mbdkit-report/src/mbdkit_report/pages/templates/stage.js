"use strict";
/* Draws a mechanism on a canvas: `new Stage(canvas)`, `show(film)`, and `draw(frame, whole, magnification)` or, for paper,
   `strip(frames)`. */
class Stage {
  static TAIL = 1.5;   // length of the visible paths, in seconds of the animation
  static NAMES = [
    "paper", "ink", "faint", "edge", "grid", "spring", "muscle", "alarm", "warn", "c0", "c1", "c2", "c3", "c4", "c5",
  ];

  static FORCES = { joint: "ink", load: "warn", spring: "spring" };   // colours of arrows

  constructor(canvas) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.colors = {};
    this.named = true;
    this.tint();
  }

  show(film) {
    this.film = film;
    this.bodies = film.bodies.length;
    this.crowd = film.links.length > 40;
    [this.left, this.right, this.bottom, this.top] = film.view;
    this.size = Math.max(this.right - this.left, this.top - this.bottom);
    this.centre = [(this.left + this.right) / 2, (this.bottom + this.top) / 2];
    this.turned = new Float64Array(4 * this.bodies);
    this.world = new Float64Array(2 * film.owner.length);
    this.grains = Float64Array.from(film.poses, value => value === null ? NaN : value);
    this.vectors = Float64Array.from(film.gaps.vectors, value => value === null ? NaN : value);
    this.fit();
  }

  tint() {
    const style = getComputedStyle(document.documentElement);
    for (const name of Stage.NAMES) this.colors[name] = style.getPropertyValue(`--${name}`).trim();
  }

  fit() {
    const width = this.canvas.clientWidth, wanted = width * (this.top - this.bottom) / (this.right - this.left);
    const room = Math.min(0.68 * window.innerHeight, window.innerHeight - 320); // a frame shows the controls, too
    this.resize(Math.max(220, Math.min(wanted, room)), window.devicePixelRatio || 1);
    this.fill(width, this.canvas.clientHeight);
  }

  /* Give the canvas a height [px] and `ratio` dots per pixel. */
  resize(height, ratio) {
    const { canvas } = this;
    canvas.style.height = `${Math.round(height)}px`;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    this.ratio = ratio;
    this.pen.lineCap = this.pen.lineJoin = "round";             // a new size resets the pen
  }

  /* Draw frames into a rectangle of this size [px]. */
  fill(width, height) {
    [this.width, this.height] = [width, height];
    this.scale = Math.min(width / (this.right - this.left), height / (this.top - this.bottom));
  }

  // --- geometry: the points of one frame in the global frame [m] ---
  pose(frame, body) {
    const k = 3 * (frame * this.bodies + body), [grain, turn] = this.film.grain, angle = this.grains[k + 2] * turn;
    const x = this.centre[0] + this.grains[k] * grain, y = this.centre[1] + this.grains[k + 1] * grain;
    return [x, y, Math.cos(angle), Math.sin(angle)];
  }

  point(frame, index) {
    const { local, owner } = this.film, x = local[2 * index], y = local[2 * index + 1];
    if (owner[index] < 0) return [x, y];
    const [px, py, c, s] = this.pose(frame, owner[index]);
    return [px + c * x - s * y, py + s * x + c * y];
  }

  place(frame, magnification) {
    const { local, owner } = this.film, { turned, world } = this;
    for (let body = 0; body < this.bodies; body++) turned.set(this.pose(frame, body), 4 * body);
    for (let index = 0; index < owner.length; index++) {
      const x = local[2 * index], y = local[2 * index + 1], k = 4 * owner[index];
      world[2 * index] = k < 0 ? x : turned[k] + turned[k + 2] * x - turned[k + 3] * y;
      world[2 * index + 1] = k < 0 ? y : turned[k + 1] + turned[k + 3] * x + turned[k + 2] * y;
    }
    this.pull(frame, magnification);
  }

  gap(frame, joint) {
    const k = 2 * (frame * this.film.gaps.joints.length + joint);
    return [this.vectors[k], this.vectors[k + 1]];
  }

  /* Move the ends of the bodies apart so that every gap is magnified about its middle; ground points do not move.
     A point of a body that several joints share moves by the mean. */
  pull(frame, magnification) {
    const { owner, gaps } = this.film, moves = new Map();
    const move = (index, x, y) => {
      const sum = moves.get(index) || [0, 0, 0];
      moves.set(index, [sum[0] + x, sum[1] + y, sum[2] + 1]);
    };
    gaps.ends.forEach(([a, b], joint) => {
      const [x, y] = this.gap(frame, joint).map(value => value * (magnification - 1));
      if (!Number.isFinite(x + y)) return;
      const share = owner[a] < 0 ? 1 : owner[b] < 0 ? 0 : 0.5;
      if (owner[b] >= 0) move(b, share * x, share * y);
      if (owner[a] >= 0) move(a, (share - 1) * x, (share - 1) * y);
    });
    for (const [index, [x, y, count]] of moves) {
      this.world[2 * index] += x / count;
      this.world[2 * index + 1] += y / count;
    }
  }

  // --- drawing ---
  X(x) { return this.width / 2 + (x - this.centre[0]) * this.scale; }
  Y(y) { return this.height / 2 - (y - this.centre[1]) * this.scale; }
  at(index) { return [this.X(this.world[2 * index]), this.Y(this.world[2 * index + 1])]; }

  line(corners, closed) {
    let open = false;
    for (const [x, y] of corners) {
      if (!Number.isFinite(x + y)) { open = false; continue; }
      if (open) this.pen.lineTo(x, y); else this.pen.moveTo(x, y);
      open = true;
    }
    if (closed) this.pen.closePath();
  }

  stroke(color, width, draw) {
    this.pen.beginPath();
    this.pen.strokeStyle = color;
    this.pen.lineWidth = width;
    draw();
    this.pen.stroke();
  }

  draw(frame, whole, magnification) {
    this.pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.pen.clearRect(0, 0, this.width, this.height);
    this.grid(true);
    this.paint(frame, whole, magnification);
  }

  /* Draw frames side by side with their times, up to three in a row, or six if they are narrow; return the distance of
     the grid lines [m]. */
  strip(frames) {
    const { pen, canvas, colors } = this, shape = (this.right - this.left) / (this.top - this.bottom);
    const columns = Math.min(frames.length, shape < 0.8 ? 6 : 3), width = canvas.clientWidth / columns;
    const height = Math.min(300, Math.max(90, width / shape));
    this.resize(height * Math.ceil(frames.length / columns), 3);
    this.fill(width, height);
    frames.forEach((frame, k) => {
      pen.save();
      pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      pen.translate(k % columns * width, Math.floor(k / columns) * height);
      this.stroke(colors.edge, 1, () => pen.rect(0, 0, width, height));
      pen.clip();
      this.grid(false);
      this.named = k === 0;
      this.paint(frame, true, 1);
      this.write([[`t = ${Number(this.film.time[frame].toPrecision(4))} s`, 6, 15]], colors.ink);
      pen.restore();
    });
    this.named = true;
    return this.spacing();
  }

  paint(frame, whole, magnification) {
    const { film, colors } = this;
    this.place(frame, magnification);
    const last = film.time.length - 1, duration = film.time[last] - film.time[0];
    if (whole) this.paths(0, last, 0.35);
    const shown = last > 0 ? Math.round(Stage.TAIL * film.speed / duration * last) : 0;
    this.paths(Math.max(0, frame - shown), frame, 0.75);
    film.grounds.forEach(index => this.ground(index));
    for (const ends of film.guides) this.stroke(colors.faint, 1.8, () => this.line(ends.map(end => this.at(end))));
    film.outlines.forEach((outline, body) => this.body(outline, film.colors[body]));
    this.beams(frame);
    for (const ends of film.bars) this.stroke(colors.ink, 1.8, () => this.line(ends.map(end => this.at(end))));
    for (const points of film.shapes) this.stroke(colors.ink, 1.4, () => this.line(points.map(k => this.at(k))));
    for (const points of film.muscles) this.stroke(colors.muscle, 1.6, () => this.line(points.map(k => this.at(k))));
    film.springs.forEach(ends => this.spring(ends));
    film.coils.forEach(index => this.coil(...this.at(index)));
    if (!this.crowd) this.marks();
    if (film.arrows && this.pushed) film.arrows.kinds.forEach((kind, k) => this.arrow(frame, kind, k));
    film.gaps.ends.forEach((ends, joint) => this.apart(ends[1], this.gap(frame, joint), magnification));
    if (this.named) this.names();
  }

  /* Write the names of elements beside the points that they name. */
  names() {
    const { world, film } = this;
    for (const [text, color, first, second, share, right, down] of film.names) {
      const [x, y] = [0, 1].map(k => world[2 * first + k] + share * (world[2 * second + k] - world[2 * first + k]));
      const size = this.width < 300 ? 0.75 : 1;
      if (Number.isFinite(x + y)) {
        this.write([[text, this.X(x) + size * right, this.Y(y) + size * down + 4]], this.color(color), 12 * size);
      }
    }
  }

  /* Distance of the grid lines [m]. */
  spacing() { return Stage.nice(Math.min(80, this.width / 6) / this.scale); }

  grid(labelled) {
    const { scale, centre, colors, width, height } = this;
    const step = this.spacing();
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), labels = [["x [m]", width - 36, height - 6], ["y [m]", 5, 12]];
    this.stroke(colors.grid, 1, () => {
      for (let k = Math.ceil((centre[0] - width / 2 / scale) / step); this.X(k * step) < width; k++) {
        const x = Math.round(this.X(k * step)) + 0.5;
        this.line([[x, 0], [x, height]]);
        if (x > 40 && x < width - 70) labels.push([(k * step).toFixed(digits), x + 4, height - 6]);
      }
      for (let k = Math.ceil((centre[1] - height / 2 / scale) / step); this.Y(k * step) > 0; k++) {
        const y = Math.round(this.Y(k * step)) + 0.5;
        this.line([[0, y], [width, y]]);
        if (y > 32 && y < height - 24) labels.push([(k * step).toFixed(digits), 5, y - 4]);
      }
    });
    if (labelled) this.write(labels, colors.faint);
  }

  /* Write labels [text, x, y], with a rim in the colour of the background. */
  write(labels, color, size = 12) {
    const { pen } = this;
    pen.font = `${size}px system-ui, sans-serif`;
    pen.fillStyle = color;
    pen.strokeStyle = this.colors.paper;
    pen.lineWidth = 4;
    for (const label of labels) { pen.strokeText(...label); pen.fillText(...label); }
  }

  static nice(step) {
    const power = 10 ** Math.floor(Math.log10(step));
    return power * [1, 2, 5, 10].find(digit => digit * power >= step * 0.999);
  }

  color(key) { return this.colors[key]; }

  paths(first, last, alpha) {
    this.pen.globalAlpha = alpha;
    for (const trace of this.film.traces) this.stroke(this.color(trace.color), 1.5, () => {
      const corners = [];
      for (let k = first; k <= last; k++) {
        const [x, y] = this.point(k, trace.point);
        corners.push([this.X(x), this.Y(y)]);
      }
      this.line(corners);
    });
    this.pen.globalAlpha = 1;
  }

  ground(index) {
    const [x, y] = this.at(index);
    this.stroke(this.colors.faint, 1.3, () => {
      this.line([[x, y], [x - 7, y + 11], [x + 7, y + 11]], true);
      this.line([[x - 12, y + 11], [x + 12, y + 11]]);
      for (let k = -10; k <= 10; k += 5) this.line([[x + k, y + 11], [x + k - 4, y + 16]]);
    });
  }

  /* Thickness of bodies [px]. */
  weight() { return this.crowd ? 1.6 : this.width < 300 ? 3 : this.width < 600 ? 4 : 5.5; }

  /* Draw beams as curves through their nodes, coloured by their bending moments. */
  beams(frame) {
    const { beams, bending, colors } = this.film, { pen } = this;
    const count = beams.reduce((sum, beam) => sum + beam.elements, 0);
    let first = frame * count;
    for (const beam of beams) {
      beam.element.forEach((element, k) => {
        const [start, out, into, end] = [0, 1, 2, 3].map(step => this.at(beam.corners[3 * k + step]));
        if (![...start, ...out, ...into, ...end].every(Number.isFinite)) return;
        const color = bending ? this.tone(bending.percent[first + element]) : this.color(colors[beam.body]);
        this.stroke(color, this.weight(), () => { pen.moveTo(...start); pen.bezierCurveTo(...out, ...into, ...end); });
      });
      first += beam.elements;
    }
  }

  /* Colour of a bending moment, given in percent of the largest one. */
  tone(percent) {
    const [from, to] = ["edge", percent < 0 ? "c0" : "c1"].map(key => Stage.rgb(this.colors[key]));
    const share = Math.abs(percent) / 100;
    return `rgb(${from.map((value, k) => Math.round(value + share * (to[k] - value))).join(" ")})`;
  }

  static rgb(color) { return [1, 3, 5].map(start => parseInt(color.slice(start, start + 2), 16)); }

  body(outline, key) {
    if (!outline.length) return;
    const { pen } = this, color = this.color(key), corners = outline.map(index => this.at(index));
    if (corners.length === 1) {
      pen.beginPath();
      pen.fillStyle = color;
      if (Number.isFinite(corners[0][0])) pen.arc(...corners[0], this.crowd ? 2 : 7, 0, 7);
      pen.fill();
      return;
    }
    this.stroke(color, this.weight(), () => this.line(corners, corners.length > 2));
    if (corners.length > 2) { pen.globalAlpha = 0.25; pen.fillStyle = color; pen.fill(); pen.globalAlpha = 1; }
  }

  spring([a, b]) {
    const [ax, ay] = this.at(a), [bx, by] = this.at(b), length = Math.hypot(bx - ax, by - ay) || 1;
    const nx = -(by - ay) / length, ny = (bx - ax) / length, tooth = 0.018 * this.size * this.scale;
    const corner = (share, side) =>
      [ax + share * (bx - ax) + side * tooth * nx, ay + share * (by - ay) + side * tooth * ny];
    const corners = [corner(0, 0), corner(0.15, 0)];
    for (let k = 0; k < 12; k++) corners.push(corner(0.15 + 0.7 * (k + 0.5) / 12, k % 2 ? -1 : 1));
    this.stroke(this.colors.spring, 1.8, () => this.line([...corners, corner(0.85, 0), corner(1, 0)]));
  }

  /* Draw a spring between the angles of two bodies. */
  coil(x, y) {
    this.stroke(this.colors.spring, 1.4, () => this.line(Array.from({ length: 40 }, (_, k) => {
      const turn = 4.5 * Math.PI * k / 39, radius = 2 + 10 * k / 39;
      return [x + radius * Math.cos(turn), y + radius * Math.sin(turn)];
    })));
  }

  marks() {
    const { pen, film, colors } = this;
    film.centres.forEach((index, body) => {
      if (film.outlines[body].length < 2) return;
      const [x, y] = this.at(index);
      this.stroke(colors.ink, 1.2, () => {
        pen.arc(x, y, 4.5, 0, 7);
        this.line([[x - 4.5, y], [x + 4.5, y]]);
        this.line([[x, y - 4.5], [x, y + 4.5]]);
      });
    });
    for (const index of film.sliders) {
      const [x, y] = this.at(index);
      pen.fillStyle = colors.paper;
      this.stroke(colors.ink, 1.5, () => this.line([[x - 6, y - 6], [x + 6, y - 6], [x + 6, y + 6], [x - 6, y + 6]], true));
      pen.fill();
    }
    for (const index of film.pins) this.pin(...this.at(index), colors.ink);
    for (const index of film.welds) {
      const [x, y] = this.at(index);
      pen.fillStyle = colors.ink;
      if (Number.isFinite(x)) pen.fillRect(x - 3.5, y - 3.5, 7, 7);
    }
  }

  pin(x, y, color) {
    this.pen.fillStyle = this.colors.paper;
    this.stroke(color, 1.5, () => { if (Number.isFinite(x + y)) this.pen.arc(x, y, 4, 0, 7); });
    this.pen.fill();
  }

  /* Draw a force to scale, from its point of application; forces too short for a head are left out. */
  arrow(frame, kind, number) {
    const { kinds, values, scale } = this.film.arrows, k = 4 * (frame * kinds.length + number);
    const x = this.X(values[k]), y = this.Y(values[k + 1]), meters = scale * this.scale;
    const dx = meters * values[k + 2], dy = -meters * values[k + 3], length = Math.hypot(dx, dy);
    if (!(length > 4)) return;
    const [ux, uy] = [dx / length, dy / length], head = Math.min(10, length / 2);
    const wing = side => [x + dx - head * (ux + side * 0.4 * uy), y + dy - head * (uy - side * 0.4 * ux)];
    this.stroke(this.colors[Stage.FORCES[kind]], 2, () => {
      this.line([[x, y], [x + dx, y + dy]]);
      this.line([wing(1), [x + dx, y + dy], wing(-1)]);
    });
  }

  /* Draw a visible gap: both points of the joint and a line between them. */
  apart(end, gap, magnification) {
    const [dx, dy] = gap.map(value => value * magnification * this.scale), [x, y] = this.at(end);
    if (!(Math.hypot(dx, dy) > 1.5) || !Number.isFinite(x + y)) return;
    this.stroke(this.colors.alarm, 2.5, () => this.line([[x, y], [x - dx, y + dy]]));
    this.pin(x, y, this.colors.alarm);
    this.pin(x - dx, y + dy, this.colors.alarm);
  }
}
