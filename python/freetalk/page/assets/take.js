// One performance: what Python's pack_take wrote, and the moving surface made from it.

const ARRAY_TYPES = {
  float32: Float32Array, int16: Int16Array, uint16: Uint16Array, uint32: Uint32Array, uint8: Uint8Array,
};
const WEIGHT_STEPS = 65535;

async function gunzip(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function fromBase64(text) {
  const binary = atob(text.trim());
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; ++i) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** Values whose first bytes come first, then all second bytes, and so on. */
function fromPlanes(bytes, start, type, count) {
  const size = type.BYTES_PER_ELEMENT;
  const joined = new Uint8Array(count * size);
  for (let byte = 0; byte < size; ++byte)
    for (let i = 0, from = start + byte * count; i < count; ++i) joined[i * size + byte] = bytes[from + i];
  return new type(joined.buffer);
}

async function openTake(packed, id) {
  const bytes = await gunzip(packed);
  if (String.fromCharCode(...bytes.subarray(0, 4)) !== "ftk1") throw new Error("This is not a take of freetalk.");
  const length = new DataView(bytes.buffer).getUint32(4, true);
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(8, 8 + length)));
  const first = 8 + Math.ceil(length / 4) * 4;
  const arrays = {};
  for (const [name, entry] of Object.entries(header.arrays)) {
    const count = entry.shape.reduce((a, b) => a * b, 1);
    arrays[name] = fromPlanes(bytes, first + entry.offset, ARRAY_TYPES[entry.type], count);
  }
  const take = new Take(id, header, arrays);
  if (header.texture) {
    take.picture = await createImageBitmap(new Blob([arrays.texture], { type: header.texture.type }), { imageOrientation: "flipY" });
  }
  return take;
}

class Take {
  constructor(id, header, arrays) {
    this.id = id;
    this.name = header.name;
    this.header = header;
    this.fps = header.fps;
    this.frames = header.frames;
    this.rest = arrays.rest;
    this.faces = arrays.faces;
    this.corners = arrays.corners || null; // drawn vertex -> moving vertex
    this.texcoords = arrays.texcoords || null;
    this.colors = arrays.colors;
    this.sound = arrays.sound || new Int16Array(0);
    this.rate = header.rate_hz || 16000;
    this.landmarks = arrays.landmarks || null;
    this.curves = arrays.curves || null;
    this.mouth = arrays.mouth_edges || null;
    this.picture = null;
    this.vertices = this.rest.length / 3;
    this.targets = arrays.targets;
    this.weights = arrays.weights;
    this.numTargets = this.weights.length / this.frames;
    this.head = arrays.head || null; // (frames, 16) its pose
    this.pose = this.head && this.head.slice(0, 16);
    this.positions = this.rest.slice();
    this.normals = new Float32Array(this.rest.length);
    this.shown = -1; // frame number of positions, fractional; of a live stream, how many were shown
    if (header.live) this.updateNormals();
  }

  get motionSeconds() { return this.frames / this.fps; }
  get duration() { return Math.max(this.motionSeconds, this.sound.length / this.rate); }

  /** Moves positions and normals to a time; true where they changed. */
  moveTo(seconds) {
    if (this.header.live) return false; // its stream moves it
    const frame = clamp(seconds * this.fps, 0, this.frames - 1);
    if (frame === this.shown) return false;
    this.shown = frame;
    const before = Math.floor(frame), after = Math.min(before + 1, this.frames - 1), share = frame - before;
    const scale = this.header.step_m / WEIGHT_STEPS, count = this.numTargets;
    const weights = new Float32Array(count);
    for (let k = 0; k < count; ++k) {
      const a = this.weights[before * count + k], b = this.weights[after * count + k];
      weights[k] = scale * (a + share * (b - a));
    }
    if (this.head) for (let i = 0; i < 16; ++i) this.pose[i] = (1 - share) * this.head[16 * before + i] + share * this.head[16 * after + i];
    this.sum(weights);
    return true;
  }

  /** positions = rest + sum of weighted targets; four targets a pass, which is bound by memory. */
  sum(weights) {
    const { rest, targets, positions } = this, size = rest.length;
    positions.set(rest);
    const used = [];
    for (let k = 0; k < weights.length; ++k) if (weights[k] !== 0) used.push(k);
    for (let u = 0; u < used.length; u += 4) {
      const [a, b, c, d] = [0, 1, 2, 3].map((i) => (used[u + i] ?? 0) * size);
      const [wa, wb, wc, wd] = [0, 1, 2, 3].map((i) => (u + i < used.length ? weights[used[u + i]] : 0));
      for (let i = 0; i < size; ++i)
        positions[i] += wa * targets[a + i] + wb * targets[b + i] + wc * targets[c + i] + wd * targets[d + i];
    }
    this.updateNormals();
  }

  updateNormals() {
    const { positions: p, normals: n, faces, corners } = this;
    n.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      let a = faces[f], b = faces[f + 1], c = faces[f + 2];
      if (corners) { a = corners[a]; b = corners[b]; c = corners[c]; }
      a *= 3; b *= 3; c *= 3;
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      n[a] += x; n[a + 1] += y; n[a + 2] += z;
      n[b] += x; n[b + 1] += y; n[b + 2] += z;
      n[c] += x; n[c + 1] += y; n[c + 2] += z;
    }
  }

  /** Where a ray meets the surface first; null where it does not. */
  hit(eye, along) {
    const { positions: p, faces, corners } = this, at = (i) => 3 * (corners ? corners[i] : i);
    let nearest = Infinity;
    for (let f = 0; f < faces.length; f += 3) {
      const a = at(faces[f]), b = at(faces[f + 1]), c = at(faces[f + 2]);
      const u = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]], v = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
      const q = cross(along, v), size = dot(u, q);
      if (!size) continue;
      const from = [eye[0] - p[a], eye[1] - p[a + 1], eye[2] - p[a + 2]], s = dot(from, q) / size;
      if (s < 0 || s > 1) continue;
      const r = cross(from, u), t = dot(along, r) / size, distance = dot(v, r) / size;
      if (t >= 0 && s + t <= 1 && distance > 0 && distance < nearest) nearest = distance;
    }
    return nearest < Infinity ? eye.map((c, k) => c + nearest * along[k]) : null;
  }

  /** Whether errors against another take can be told: the same surface, vertex by vertex. */
  matches(other) { return other.vertices === this.vertices && other.faces.length === this.faces.length; }

  /** Distance of each vertex from that of another take, mm, with mean and largest. */
  errors(truth, out) {
    const p = this.positions, q = truth.positions;
    let sum = 0, largest = 0;
    for (let v = 0, i = 0; v < out.length; ++v, i += 3) {
      const x = p[i] - q[i], y = p[i + 1] - q[i + 1], z = p[i + 2] - q[i + 2];
      const mm = 1000 * Math.sqrt(x * x + y * y + z * z);
      out[v] = mm;
      sum += mm;
      if (mm > largest) largest = mm;
    }
    return { mean: sum / out.length, largest };
  }

  /** Smallest and largest sample of each of `count` stretches of the sound, in [-1, 1]. */
  peaks(count, seconds) {
    const low = new Float32Array(count), high = new Float32Array(count);
    const step = (seconds * this.rate) / count;
    for (let i = 0; i < count; ++i) {
      const end = Math.min(Math.floor((i + 1) * step), this.sound.length);
      for (let s = Math.floor(i * step); s < end; ++s) {
        const value = this.sound[s] / 32768;
        if (value < low[i]) low[i] = value;
        if (value > high[i]) high[i] = value;
      }
    }
    return { low, high };
  }

  /** Pairs of vertices of all edges, each once, of the drawn surface. */
  edges() {
    if (this.edgeList) return this.edgeList;
    const seen = new Set(), list = [], count = this.rest.length;
    for (let f = 0; f < this.faces.length; f += 3)
      for (let k = 0; k < 3; ++k) {
        const a = this.faces[f + k], b = this.faces[f + ((k + 1) % 3)];
        const key = Math.min(a, b) * count + Math.max(a, b);
        if (seen.has(key)) continue;
        seen.add(key);
        list.push(a, b);
      }
    this.edgeList = new Uint32Array(list);
    return this.edgeList;
  }
}
