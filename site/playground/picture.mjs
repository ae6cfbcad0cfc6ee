// SPDX-License-Identifier: GPL-3.0-or-later
// Draws the skin by WebGL 2: soft light, a shadow on the ground, and the tissue's own motion as a warmer color.

const VERTEX = `#version 300 es
layout(location = 0) in vec3 at;
layout(location = 1) in vec3 normal;
layout(location = 2) in float motion;
uniform mat4 camera;
uniform float ground;
uniform bool shadow;
out vec3 n, x;
out float heat;
void main() {
  vec3 p = at;
  if (shadow) p = vec3(p.xy + (p.z - ground) * vec2(.28, .14), ground);
  n = normal;
  x = p;
  heat = motion;
  gl_Position = camera * vec4(p, 1);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 n, x;
in float heat;
uniform vec3 eye, skin;
uniform bool shadow, dark;
out vec4 color;
void main() {
  if (shadow) { color = vec4(0, 0, 0, dark ? .34 : .13); return; }
  vec3 N = normalize(n), E = normalize(eye - x);
  if (dot(N, E) < 0.) N = -N;
  vec3 key = normalize(vec3(-.45, -.7, .85)), fill = normalize(vec3(.8, -.4, .1));
  float rim = pow(1. - max(dot(N, E), 0.), 3.5);
  vec3 base = mix(skin, vec3(.95, .42, .08), smoothstep(.003, .045, heat) * .85);
  float wrap = max((dot(N, key) + .25) / 1.25, 0.);
  vec3 light = vec3(1.6, 1.5, 1.38) * wrap + vec3(.22, .28, .36) * max(dot(N, fill), 0.)
             + mix(vec3(.16, .13, .12), vec3(.36, .40, .46), .5 + .5 * N.z);
  float shine = .22 * pow(max(dot(N, normalize(key + E)), 0.), 48.);
  vec3 c = base * light + shine + rim * (dark ? .22 : .12) * vec3(.6, .8, 1.);
  color = vec4(pow(c / (1. + .42 * c), vec3(1. / 2.2)), 1);
}`;

const sub = (a, b) => a.map((x, i) => x - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const SLOPE = Math.tan(0.26);  // of half the view

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: true, stencil: true }));
    if (!gl) throw new Error("This browser has no WebGL 2, which draws the character");
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    this.uniform = {};
    for (const name of ["camera", "ground", "shadow", "eye", "skin", "dark"])
      this.uniform[name] = gl.getUniformLocation(program, name);
    this.vertices = gl.createBuffer();
    this.corners = gl.createBuffer();
    this.darkness = matchMedia("(prefers-color-scheme: dark)");
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  /// Shows another skin. turn: degrees by which the camera goes around it; color: linear.
  show(triangles, surface, { turn, color }) {
    const { gl } = this, count = surface.length / 7;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.vertices);
    gl.bufferData(gl.ARRAY_BUFFER, 28 * count, gl.DYNAMIC_DRAW);
    [[3, 0], [3, 12], [1, 24]].forEach(([size, offset], i) => {
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, size, gl.FLOAT, false, 0, offset * count);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    gl.uniform3f(this.uniform.skin, ...color);
    const low = [Infinity, Infinity, Infinity], high = low.map((x) => -x);
    for (let v = 0; v < 3 * count; ++v) {
      low[v % 3] = Math.min(low[v % 3], surface[v]);
      high[v % 3] = Math.max(high[v % 3], surface[v]);
    }
    this.size = Math.hypot(...sub(high, low));
    this.center = low.map((x, i) => (x + high[i]) / 2);
    this.ground = low[2] - 0.06 * this.size;
    this.turn = (turn * Math.PI) / 180;
    this.count = triangles.length;
  }

  /// Looks at the center from a distance at which it fits into the picture, whatever its format.
  look() {
    const aspect = this.canvas.width / this.canvas.height, up = 0.24;
    const away = (0.44 * this.size) / SLOPE / Math.min(1, aspect) + 0.1 * this.size;
    const toEye = [Math.sin(this.turn) * Math.cos(up), -Math.cos(this.turn) * Math.cos(up), Math.sin(up)];
    const eye = this.center.map((x, i) => x + away * toEye[i]), near = 0.1 * away, far = 10 * away;
    const front = toEye.map((x) => -x), right = unit(cross(front, [0, 0, 1])), above = cross(right, front);
    this.axes = { eye, front, right, above, away };
    const view = [right, above, toEye].map((w) => [...w, -dot(w, eye)]);
    const rows = [view[0].map((x) => x / SLOPE / aspect), view[1].map((x) => x / SLOPE),
      view[2].map((x, i) => (x * (far + near) + (i == 3 ? 2 * far * near : 0)) / (near - far)), view[2].map((x) => -x)];
    this.gl.uniformMatrix4fv(this.uniform.camera, false, [0, 1, 2, 3].flatMap((c) => rows.map((row) => row[c])));
    this.gl.uniform3f(this.uniform.eye, ...eye);
  }

  /// A displacement on the screen, in CSS pixels, as one in the world at the character.
  moved(x, y) {
    const scale = (2 * this.axes.away * SLOPE) / this.canvas.clientHeight;
    return [0, 1, 2].map((i) => scale * (x * this.axes.right[i] - y * this.axes.above[i]));
  }

  /// The direction in which the camera sees a place of the canvas, in CSS pixels.
  ray(x, y) {
    const [right, up] = [2 * x / this.canvas.clientHeight - this.canvas.clientWidth / this.canvas.clientHeight,
      1 - 2 * y / this.canvas.clientHeight].map((place) => place * SLOPE);
    return unit(this.axes.front.map((f, i) => f + right * this.axes.right[i] + up * this.axes.above[i]));
  }

  draw(surface) {
    const { gl, canvas, uniform } = this, ratio = Math.min(devicePixelRatio, 2), dark = this.darkness.matches;
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width != width || canvas.height != height) Object.assign(canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(...(dark ? [0.075, 0.082, 0.094] : [0.945, 0.94, 0.925]), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    this.look();
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, surface);
    gl.uniform1f(uniform.ground, this.ground);
    gl.uniform1i(uniform.dark, dark);
    gl.uniform1i(uniform.shadow, 0);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    // Each pixel of the shadow darkens once.
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 0, 255);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.enable(gl.BLEND);
    gl.uniform1i(uniform.shadow, 1);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.BLEND);
    gl.disable(gl.STENCIL_TEST);
  }
}
