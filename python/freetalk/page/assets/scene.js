// Drawing: one WebGL2 canvas, one pane a take, one camera for all of them.

const VERTEX_SHADER = `#version 300 es
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 color;
layout(location = 3) in vec2 texcoord;
layout(location = 4) in float value;
uniform mat4 camera;
uniform float pointSize;
out vec3 place;
out vec3 direction;
out vec3 tint;
out vec2 at;
out float amount;
void main() {
  place = position;
  direction = normal;
  tint = color;
  at = texcoord;
  amount = value;
  gl_Position = camera * vec4(position, 1.0);
  gl_PointSize = pointSize;
}`;

const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec3 place;
in vec3 direction;
in vec3 tint;
in vec2 at;
in float amount;
uniform vec3 eye;
uniform int mode;        // 0 vertex colours, 1 clay, 2 texture, 3 error, 4 flat colour, 5 round point, 6 eyeball
uniform vec4 flatColor;
uniform float largest;   // of the error's colours
uniform vec4 ball;       // centre and radius of an eyeball
uniform sampler2D picture;
out vec4 result;

vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }

// Turbo, a polynomial of Google's colour map (Apache 2.0).
vec3 turbo(float x) {
  vec4 v = vec4(1.0, x, x * x, x * x * x);
  vec2 w = v.zw * v.z;
  return clamp(vec3(
    dot(v, vec4(0.13572138, 4.61539260, -42.66032258, 132.13108234)) + dot(w, vec2(-152.94239396, 59.28637943)),
    dot(v, vec4(0.09140261, 2.19418839, 4.84296658, -14.18503333)) + dot(w, vec2(4.27729857, 2.82956604)),
    dot(v, vec4(0.10667330, 12.64194608, -60.58204836, 110.36276771)) + dot(w, vec2(-89.90310912, 27.34824973))),
    0.0, 1.0);
}

void main() {
  if (mode == 4) { result = flatColor; return; }
  if (mode == 5) {
    float r = length(gl_PointCoord - 0.5);
    if (r > 0.5) discard;
    result = vec4(mix(flatColor.rgb, vec3(1.0), smoothstep(0.34, 0.4, r)), 1.0);
    return;
  }
  vec3 n = normalize(direction);
  vec3 view = normalize(eye - place);
  bool inside = !gl_FrontFacing;
  if (inside) n = -n;
  vec3 base = mode == 1 ? linear(vec3(0.74, 0.73, 0.71))
            : mode == 2 ? linear(texture(picture, at).rgb)
            : mode == 3 ? linear(turbo(clamp(amount / largest, 0.0, 1.0)))
            : linear(tint);
  float gloss = 0.12, sharp = 18.0;
  if (mode == 6) {
    n = normalize(place - ball.xyz);
    float angle = n.z;
    float edge = fwidth(angle) + 0.004;
    base = mix(linear(vec3(0.90, 0.88, 0.83)), linear(vec3(0.25, 0.36, 0.42)), smoothstep(0.875 - edge, 0.875 + edge, angle));
    base = mix(base, vec3(0.002), smoothstep(0.978 - edge, 0.978 + edge, angle));
    gloss = 0.6; sharp = 70.0;
  }
  if (inside && mode != 3) base = linear(vec3(0.36, 0.14, 0.13)) * 0.6;
  vec3 key = normalize(vec3(-0.45, 0.55, 0.75)), fill = normalize(vec3(0.8, 0.1, 0.55));
  float wrap = max((dot(n, key) + 0.25) / 1.25, 0.0);
  vec3 light = vec3(1.0, 0.96, 0.9) * 0.95 * wrap + vec3(0.75, 0.85, 1.0) * 0.28 * max(dot(n, fill), 0.0)
             + mix(vec3(0.10, 0.085, 0.08), vec3(0.24, 0.26, 0.29), 0.5 + 0.5 * n.y);
  vec3 h = normalize(key + view);
  float shine = gloss * pow(max(dot(n, h), 0.0), sharp);
  float rim = 0.22 * pow(1.0 - max(dot(n, view), 0.0), 4.0) * max(0.3 + n.y, 0.0);
  vec3 c = mode == 3 ? base * (0.45 + 0.55 * wrap) : base * light + shine + rim * vec3(0.8, 0.9, 1.0);
  result = vec4(pow(c, vec3(1.0 / 2.2)), 1.0);
}`;

const BACKDROP_VERTEX = `#version 300 es
out vec2 at;
void main() {
  at = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(at, 0.0, 1.0);
}`;
const BACKDROP_FRAGMENT = `#version 300 es
precision highp float;
in vec2 at;
uniform vec3 top;
uniform vec3 bottom;
out vec4 result;
void main() {
  vec3 c = mix(bottom, top, smoothstep(-1.0, 1.0, at.y - 0.25 * dot(at, at)));
  float grain = fract(sin(dot(gl_FragCoord.xy, vec2(12.9898, 78.233))) * 43758.5453) - 0.5;
  result = vec4(c + grain / 255.0, 1.0);
}`;

const FIELD_OF_VIEW = (22 * Math.PI) / 180;
const UNIFORMS = ["camera", "eye", "mode", "flatColor", "largest", "ball", "picture", "pointSize"];

/** Where the viewer stands: angles around the middle of the face, distance, and how far it was moved. */
class Camera {
  constructor() { this.reset(); }

  reset(yaw = 0.2, pitch = 0.03) {
    this.yaw = yaw;
    this.pitch = pitch;
    this.zoom = 1;
    this.shift = [0, 0]; // of the face in the picture, m
  }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = clamp(this.pitch + dy, -1.5, 1.5);
  }

  scale(factor) { this.zoom = clamp(this.zoom * factor, 0.25, 12); }

  /** Matrix and eye for a pane of this aspect that shows a face of this framing. */
  look(framing, aspect) {
    const { center, extent } = framing;
    const half = Math.max(extent[1], extent[0] / aspect) / 2;
    const distance = (1.16 * half) / Math.tan(FIELD_OF_VIEW / 2) / this.zoom + extent[2] / 2;
    const cosine = Math.cos(this.pitch);
    const out = [Math.sin(this.yaw) * cosine, Math.sin(this.pitch), Math.cos(this.yaw) * cosine];
    const right = unit(cross([0, 1, 0], out)), up = cross(out, right);
    const target = center.map((c, k) => c - right[k] * this.shift[0] - up[k] * this.shift[1]);
    const eye = target.map((c, k) => c + distance * out[k]);
    const size = Math.hypot(...extent);
    const projection = perspective(FIELD_OF_VIEW, aspect, Math.max(distance - 4 * size, 0.02 * distance), distance + 6 * size);
    return { matrix: multiply(projection, lookAt(eye, target, [0, 1, 0])), eye, distance, axes: [right, up, out] };
  }

  /** Eye and direction of the ray through a place of a pane, both from -1 to 1, right and up. */
  ray(framing, aspect, across, upward) {
    const { eye, axes: [right, up, out] } = this.look(framing, aspect), half = Math.tan(FIELD_OF_VIEW / 2);
    return { eye, along: unit(out.map((c, k) => across * half * aspect * right[k] + upward * half * up[k] - c)) };
  }
}

/** The buffers of one take. */
class Surface {
  constructor(gl, take) {
    this.gl = gl;
    this.take = take;
    this.drawn = take.corners ? take.corners.length : take.vertices;
    this.errors = new Float32Array(take.vertices);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    this.position = this.attribute(0, 3, gl.FLOAT, false, gl.DYNAMIC_DRAW, 12 * this.drawn);
    this.normal = this.attribute(1, 3, gl.FLOAT, false, gl.DYNAMIC_DRAW, 12 * this.drawn);
    this.attribute(2, 3, gl.UNSIGNED_BYTE, true, gl.STATIC_DRAW, this.gather(take.colors, 3, Uint8Array));
    if (take.texcoords) this.attribute(3, 2, gl.FLOAT, false, gl.STATIC_DRAW, take.texcoords);
    this.value = this.attribute(4, 1, gl.FLOAT, false, gl.DYNAMIC_DRAW, 4 * this.drawn);
    this.triangles = this.indices(take.faces);
    this.lines = null;
    gl.bindVertexArray(null);
    this.texture = take.picture ? this.upload(take.picture) : null;
    this.extras = [];
    for (const eye of take.header.eyes || []) this.extras.push(new Eyeball(gl, eye));
    if (take.mouth) this.extras.push(new Mouth(gl, take));
    this.marks = take.landmarks ? new Marks(gl, take) : null;
    this.place();
  }

  attribute(location, size, type, normalized, usage, data) {
    const { gl } = this, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, usage);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, size, type, normalized, 0, 0);
    return buffer;
  }

  indices(data) {
    const { gl } = this, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, data, gl.STATIC_DRAW);
    return buffer;
  }

  /** Values of moving vertices at the drawn ones. */
  gather(values, size, type = Float32Array) {
    const { corners } = this.take;
    if (!corners) return values;
    const out = new type(corners.length * size);
    for (let i = 0; i < corners.length; ++i)
      for (let k = 0; k < size; ++k) out[i * size + k] = values[corners[i] * size + k];
    return out;
  }

  upload(picture) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    return texture;
  }

  replace(buffer, data) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, data);
  }

  /** Brings the take's positions to the graphics card. */
  place() {
    this.replace(this.position, this.gather(this.take.positions, 3));
    this.replace(this.normal, this.gather(this.take.normals, 3));
    for (const extra of this.extras) extra.place?.();
    this.marks?.place();
  }

  compare(truth) {
    const found = this.take.errors(truth, this.errors);
    this.replace(this.value, this.gather(this.errors, 1));
    return found;
  }

  lineIndices() {
    if (!this.lines) {
      const edges = this.take.edges();
      this.gl.bindVertexArray(this.array);
      this.lines = { buffer: this.indices(edges), count: edges.length };
      this.gl.bindVertexArray(null);
    }
    return this.lines;
  }
}

/** A small mesh of its own: positions and triangles. */
class Piece {
  constructor(gl, positions, triangles) {
    this.gl = gl;
    this.count = triangles ? triangles.length : positions.length / 3;
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    this.buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, positions, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    if (triangles) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
  }

  update(positions) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.buffer);
    this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, positions);
  }
}

class Eyeball extends Piece {
  constructor(gl, { center, radius }) {
    const rings = 24, sides = 36, points = [], triangles = [];
    for (let r = 0; r <= rings; ++r)
      for (let s = 0; s <= sides; ++s) {
        const a = (Math.PI * r) / rings, b = (2 * Math.PI * s) / sides;
        points.push(center[0] + radius * Math.sin(a) * Math.cos(b), center[1] + radius * Math.sin(a) * Math.sin(b), center[2] + radius * Math.cos(a));
        if (r === rings || s === sides) continue;
        const i = r * (sides + 1) + s, j = i + sides + 1;
        triangles.push(i, j, i + 1, i + 1, j, j + 1);
      }
    super(gl, new Float32Array(points), new Uint16Array(triangles));
    this.ball = [...center, radius];
  }
}

/** Dark behind open lips: a fan from the rim to a point deep inside. */
class Mouth extends Piece {
  constructor(gl, take) {
    const edges = take.mouth.length / 2, triangles = new Uint32Array(3 * edges);
    for (let e = 0; e < edges; ++e) triangles.set([2 * e, 2 * e + 1, 2 * edges], 3 * e);
    const points = new Float32Array(3 * (2 * edges + 1));
    super(gl, points, triangles);
    this.take = take;
    this.points = points;
  }

  place() {
    const { mouth, positions, header } = this.take, middle = [0, 0, 0];
    mouth.forEach((vertex, i) => {
      for (let k = 0; k < 3; ++k) {
        this.points[3 * i + k] = positions[3 * vertex + k];
        middle[k] += positions[3 * vertex + k] / mouth.length;
      }
    });
    this.points.set([middle[0], middle[1], middle[2] - header.mouth_depth], 3 * mouth.length);
    this.update(this.points);
  }
}

class Marks extends Piece {
  constructor(gl, take) {
    const points = new Float32Array(3 * take.landmarks.length);
    super(gl, points, null);
    this.take = take;
    this.points = points;
  }

  place() {
    const { landmarks, positions } = this.take;
    landmarks.forEach((vertex, i) => this.points.set(positions.subarray(3 * vertex, 3 * vertex + 3), 3 * i));
    this.update(this.points);
  }
}

class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("This browser shows no WebGL2. Update it, or turn on its hardware acceleration.");
    this.gl = gl;
    this.camera = new Camera();
    this.backdrop = { top: [0.3, 0.3, 0.3], bottom: [0.1, 0.1, 0.1] };
    this.surfaces = new Map();
    this.quality = 1; // of the drawing's resolution: less while a slow machine plays
    this.smooth = true; // several samples a pixel: one while a slow machine plays
    this.samples = null; // the picture that they are drawn to
    this.pins = null; // points that a person marks
    this.program = this.compile(VERTEX_SHADER, FRAGMENT_SHADER);
    this.backdropProgram = this.compile(BACKDROP_VERTEX, BACKDROP_FRAGMENT);
    this.at = Object.fromEntries(UNIFORMS.map((name) => [name, gl.getUniformLocation(this.program, name)]));
    this.backdropAt = ["top", "bottom"].map((name) => gl.getUniformLocation(this.backdropProgram, name));
  }

  compile(vertex, fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "The graphics card refused a program.");
    return program;
  }

  surface(take) {
    if (!this.surfaces.has(take)) this.surfaces.set(take, new Surface(this.gl, take));
    return this.surfaces.get(take);
  }

  /** Fits the drawing to the canvas; true where its size changed. */
  resize() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2) * this.quality;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width === width && this.canvas.height === height) return false;
    this.canvas.width = width;
    this.canvas.height = height;
    this.forgetSamples();
    return true;
  }

  /** A picture as large as the canvas with four samples a pixel. */
  sampled() {
    if (this.samples) return this.samples.frame;
    const { gl, canvas } = this, frame = gl.createFramebuffer(), count = Math.min(4, gl.getParameter(gl.MAX_SAMPLES));
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    const buffers = [[gl.COLOR_ATTACHMENT0, gl.RGBA8], [gl.DEPTH_ATTACHMENT, gl.DEPTH_COMPONENT24]].map(([attachment, format]) => {
      const buffer = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, count, format, canvas.width, canvas.height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, attachment, gl.RENDERBUFFER, buffer);
      return buffer;
    });
    this.samples = { frame, buffers };
    return frame;
  }

  forgetSamples() {
    if (!this.samples) return;
    this.samples.buffers.forEach((buffer) => this.gl.deleteRenderbuffer(buffer));
    this.gl.deleteFramebuffer(this.samples.frame);
    this.samples = null;
  }

  /** Draws panes [{take, box: [x, y, w, h] in shares of the canvas from its upper left}]. */
  draw(panes, look) {
    const { gl, canvas } = this, sampled = this.smooth ? this.sampled() : null;
    gl.bindFramebuffer(gl.FRAMEBUFFER, sampled);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.SCISSOR_TEST);
    const covered = panes.reduce((sum, { box }) => sum + box[2] * box[3], 0) > 0.999;
    for (const pane of covered ? panes : [{ take: null, box: [0, 0, 1, 1] }, ...panes]) {
      const [x, y, w, h] = pane.box;
      const box = [Math.round(x * canvas.width), Math.round((1 - y - h) * canvas.height), Math.round(w * canvas.width), Math.round(h * canvas.height)];
      gl.viewport(...box);
      gl.scissor(...box);
      gl.clear(gl.DEPTH_BUFFER_BIT);
      this.drawBackdrop();
      if (pane.take) this.drawTake(pane.take, look, box[2] / Math.max(box[3], 1));
    }
    if (!sampled) return;
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.disable(gl.SCISSOR_TEST);
    const all = [0, 0, canvas.width, canvas.height];
    gl.blitFramebuffer(...all, ...all, gl.COLOR_BUFFER_BIT, gl.NEAREST);
  }

  /** Marks points {x, y, z}, one after the other; none takes the marks away. */
  pin(points) { this.pins = points.length ? new Piece(this.gl, new Float32Array(points), null) : null; }

  drawBackdrop() {
    const { gl } = this;
    gl.useProgram(this.backdropProgram);
    gl.uniform3fv(this.backdropAt[0], this.backdrop.top);
    gl.uniform3fv(this.backdropAt[1], this.backdrop.bottom);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.depthMask(true);
  }

  drawTake(take, look, aspect) {
    const { gl, at } = this, surface = this.surface(take);
    const { matrix, eye, distance } = this.camera.look(take.header.framing, aspect);
    gl.useProgram(this.program);
    gl.uniformMatrix4fv(at.camera, false, take.pose ? multiply(matrix, take.pose) : matrix);
    gl.uniform3fv(at.eye, take.pose ? seenFrom(take.pose, eye) : eye);
    gl.uniform1f(at.largest, look.largestMm);
    gl.uniform1f(at.pointSize, clamp((7 * this.canvas.height) / 900 / Math.sqrt(distance), 5, 22));
    const heat = look.truth && look.truth !== take && take.matches(look.truth);
    gl.uniform1i(at.mode, heat ? 3 : look.surface === "texture" && surface.texture ? 2 : look.surface === "clay" || look.truth ? 1 : 0);
    gl.bindTexture(gl.TEXTURE_2D, surface.texture);
    gl.bindVertexArray(surface.array);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, surface.triangles);
    gl.drawElements(gl.TRIANGLES, take.faces.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (look.wireframe) this.drawWires(surface, look);
    for (const extra of surface.extras) this.drawExtra(extra);
    if (look.landmarks && surface.marks) this.drawMarks(surface.marks);
    if (this.pins) this.drawMarks(this.pins);
    gl.bindVertexArray(null);
  }

  drawWires(surface, look) {
    const { gl, at } = this, { buffer, count } = surface.lineIndices();
    gl.bindVertexArray(surface.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ZERO, gl.ONE);
    gl.uniform1i(at.mode, 4);
    gl.uniform4fv(at.flatColor, look.wireColor);
    gl.drawElements(gl.LINES, count, gl.UNSIGNED_INT, 0);
    gl.disable(gl.BLEND);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, surface.triangles);
  }

  drawExtra(extra) {
    const { gl, at } = this;
    gl.bindVertexArray(extra.array);
    gl.uniform1i(at.mode, extra.ball ? 6 : 4);
    if (extra.ball) gl.uniform4fv(at.ball, extra.ball);
    else gl.uniform4f(at.flatColor, 0.13, 0.045, 0.045, 1);
    gl.drawElements(gl.TRIANGLES, extra.count, extra.ball ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT, 0);
  }

  drawMarks(marks) {
    const { gl, at } = this;
    gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(marks.array);
    gl.uniform1i(at.mode, 5);
    gl.uniform4f(at.flatColor, 0.05, 0.46, 0.41, 1);
    gl.drawArrays(gl.POINTS, 0, marks.count);
    gl.enable(gl.DEPTH_TEST);
  }
}
