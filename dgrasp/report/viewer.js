"use strict";
// The replay viewer of the report. One WebGL 2 context draws every picture, which is then copied to its canvas.
// The URL's hash sets the view, such as #replay=2&t=0.5&yaw=30&pitch=20&zoom=1.5&full=1&shapes=1 (t:
// fraction of the timeline).

const Replays = (() => {
  // ---- data ------------------------------------------------------------------------------------------------------
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const CREASE = Math.cos((38 * Math.PI) / 180), OUTLINE = Math.cos((24 * Math.PI) / 180);

  // Triangles with a normal at each corner; shading is smooth across nearly flat edges and sharp across others.
  function geometry(mesh) {
    const v = new Uint16Array(bytes(mesh.v).buffer), faces = new Uint16Array(bytes(mesh.f).buffer);
    const at = (i, k) => mesh.lo[k] + mesh.step * v[3 * i + k];
    const count = faces.length, flat = new Float32Array(count), around = new Map();
    for (let f = 0; f < count; f += 3) {
      const e = [0, 1, 2].map((k) => at(faces[f + 1], k) - at(faces[f], k));
      const g = [0, 1, 2].map((k) => at(faces[f + 2], k) - at(faces[f], k));
      flat[f] = e[1] * g[2] - e[2] * g[1];
      flat[f + 1] = e[2] * g[0] - e[0] * g[2];
      flat[f + 2] = e[0] * g[1] - e[1] * g[0];
      for (let c = 0; c < 3; c++) {
        if (!around.has(faces[f + c])) around.set(faces[f + c], []);
        around.get(faces[f + c]).push(f);
      }
    }
    const length = (f) => Math.hypot(flat[f], flat[f + 1], flat[f + 2]) || 1e-12;
    const positions = new Float32Array(3 * count), normals = new Float32Array(3 * count);
    for (let c = 0; c < count; c++) {
      const own = c - (c % 3), n = [0, 0, 0];
      for (const f of around.get(faces[c])) {
        const dot = flat[f] * flat[own] + flat[f + 1] * flat[own + 1] + flat[f + 2] * flat[own + 2];
        if (dot >= CREASE * length(f) * length(own)) for (let k = 0; k < 3; k++) n[k] += flat[f + k];
      }
      const size = Math.hypot(...n) || 1;
      for (let k = 0; k < 3; k++) {
        positions[3 * c + k] = at(faces[c], k);
        normals[3 * c + k] = n[k] / size;
      }
    }
    return { positions, normals, count };
  }

  // The edges of a mesh at which its faces turn by more than 24 degrees, so that round shapes have none on their sides.
  function outline(g) {
    const ends = new Map(), lines = [];
    const corner = (c) => Array.from(g.positions.subarray(3 * c, 3 * c + 3));
    for (let f = 0; f < g.count; f += 3) {
      const [a, b, c] = [corner(f), corner(f + 1), corner(f + 2)];
      const e = a.map((v, k) => b[k] - v), h = a.map((v, k) => c[k] - v);
      const n = [e[1] * h[2] - e[2] * h[1], e[2] * h[0] - e[0] * h[2], e[0] * h[1] - e[1] * h[0]];
      const size = Math.hypot(...n) || 1;
      for (const pair of [[a, b], [b, c], [c, a]]) {
        const key = pair.map(String).sort().join();
        if (!ends.has(key)) ends.set(key, { pair, normals: [] });
        ends.get(key).normals.push(n.map((v) => v / size));
      }
    }
    for (const { pair, normals: [m, n] } of ends.values()) {
      if (!n || m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < OUTLINE) lines.push(...pair[0], ...pair[1]);
    }
    return { positions: new Float32Array(lines), normals: new Float32Array(lines.length), count: lines.length / 3 };
  }

  function decode(data) {
    const bodies = ({ hand, objects }) => ({ hand: hand.map(geometry),
      objects: Object.fromEntries(Object.entries(objects).map(([name, mesh]) => [name, geometry(mesh)])) });
    const replays = data.replays.map((r) => ({
      ...r,
      p: new Uint16Array(bytes(r.p).buffer),
      q: new Int16Array(bytes(r.q).buffer),
      c: new Uint32Array(bytes(r.c).buffer),
    }));
    return { ...bodies(data), shapes: data.shapes && bodies(data.shapes), replays, table: data.table };
  }

  // The pose of a body at a frame, interpolated between recorded frames: a 4 x 4 matrix in column-major order.
  function pose(r, body, frame) {
    const i = Math.max(0, Math.min(r.n - 1, Math.floor(frame))), j = Math.min(r.n - 1, i + 1);
    const w = Math.max(0, Math.min(1, frame - i)), a = i * r.bodies + body, b = j * r.bodies + body;
    const mix = (x, y) => x + w * (y - x);
    const t = [0, 1, 2].map((k) => r.lo[k] + r.step * mix(r.p[3 * a + k], r.p[3 * b + k]));
    const q = [0, 1, 2, 3].map((k) => mix(r.q[4 * a + k], r.q[4 * b + k]));
    const size = Math.hypot(...q) || 1, [s, x, y, z] = q.map((e) => e / size);
    return new Float32Array([
      1 - 2 * (y * y + z * z), 2 * (x * y + s * z), 2 * (x * z - s * y), 0,
      2 * (x * y - s * z), 1 - 2 * (x * x + z * z), 2 * (y * z + s * x), 0,
      2 * (x * z + s * y), 2 * (y * z - s * x), 1 - 2 * (x * x + y * y), 0,
      t[0], t[1], t[2], 1,
    ]);
  }

  // Seconds since the end of the grasp, when the table is removed or the motion begins; negative before that.
  const seconds = (r, frame) => (frame - r.start) * r.dt;
  const lossFrame = (r) => (r.lost_s === null ? null : r.start + r.lost_s / r.dt);

  // ---- column-major matrices -------------------------------------------------------------------------------------
  function times(a, b) {
    const out = new Float32Array(16);
    for (let c = 0; c < 4; c++)
      for (let r = 0; r < 4; r++) {
        let sum = 0;
        for (let k = 0; k < 4; k++) sum += a[4 * k + r] * b[4 * c + k];
        out[4 * c + r] = sum;
      }
    return out;
  }

  function camera(view, target, aspect) {
    const cp = Math.cos(view.pitch), sp = Math.sin(view.pitch);
    const back = [cp * Math.cos(view.yaw), cp * Math.sin(view.yaw), sp];
    const distance = 0.7 / view.zoom, eye = target.map((t, k) => t + distance * back[k]);
    const right = [-Math.sin(view.yaw), Math.cos(view.yaw), 0];
    const up = [back[1] * right[2] - back[2] * right[1], back[2] * right[0] - back[0] * right[2],
      back[0] * right[1] - back[1] * right[0]];
    const dot = (a) => -(a[0] * eye[0] + a[1] * eye[1] + a[2] * eye[2]);
    const look = new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2],
      0, dot(right), dot(up), dot(back), 1]);
    // A narrow picture has the same horizontal field of view as a square one.
    const f = Math.min(1, aspect) / Math.tan((40 * Math.PI) / 360), near = 0.02, far = 12;
    const lens = new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0,
      (2 * far * near) / (near - far), 0]);
    return { matrix: times(lens, look), eye };
  }

  const LIGHT = [0.28, -0.22, 1];

  // Projects every point along the light onto the plane z = height.
  function shadow(height) {
    const x = LIGHT[0] / LIGHT[2], y = LIGHT[1] / LIGHT[2];
    return new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, -x, -y, 0, 0, x * height, y * height, height, 1]);
  }

  function readHash(hash) {
    const found = {};
    for (const [key, value] of new URLSearchParams(hash.replace(/^#/, ""))) {
      if (value !== "" && Number.isFinite(Number(value))) found[key] = Number(value);
    }
    return found;
  }

  // ---- drawing ---------------------------------------------------------------------------------------------------
  const VERTEX = `#version 300 es
    uniform mat4 model, view; in vec3 position, normal; out vec3 w, n;
    void main() { vec4 p = model * vec4(position, 1.0); w = p.xyz; n = mat3(model) * normal; gl_Position = view * p; }`;
  const FRAGMENT = `#version 300 es
    precision highp float; uniform vec4 color; uniform vec3 eye, light, middle; uniform int kind; in vec3 w, n; out vec4 o;
    void main() {
      if (kind == 1) { o = vec4(color.rgb * color.a, color.a); return; }
      if (kind == 2) {
        vec2 g = w.xy / 0.05, d = abs(fract(g - 0.5) - 0.5) / fwidth(g);
        float fade = smoothstep(0.75, 0.2, length(w.xy - middle.xy));
        float line = 1.0 - min(min(d.x, d.y), 1.0), a = fade * color.a * (0.35 + 0.65 * line);
        o = vec4(color.rgb * a, a); return;
      }
      vec3 N = normalize(n), V = normalize(eye - w), L = normalize(light), H = normalize(L + V);
      if (dot(N, V) < 0.0) N = -N;
      vec3 base = pow(color.rgb, vec3(2.2));
      float sky = 0.5 + 0.5 * N.z, key = max(dot(N, L), 0.0), front = max(dot(N, V), 0.0);
      vec3 c = base * (0.2 + 0.22 * sky + 0.62 * key + 0.2 * front) + 0.05 * pow(max(dot(N, H), 0.0), 40.0);
      o = vec4(pow(c, vec3(1.0 / 2.2)) * color.a, color.a);
    }`;

  function painter() {
    const canvas = document.createElement("canvas");
    const gl = canvas.getContext("webgl2", { alpha: true, antialias: true, stencil: true, premultipliedAlpha: true });
    if (!gl) return null;
    const program = gl.createProgram();
    for (const [type, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "position");
    gl.bindAttribLocation(program, 1, "normal");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    const at = Object.fromEntries(["model", "view", "color", "eye", "light", "middle", "kind"].map((name) =>
      [name, gl.getUniformLocation(program, name)]));
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.uniform3fv(at.light, LIGHT);

    function upload(g) {
      const array = gl.createVertexArray();
      gl.bindVertexArray(array);
      for (const [place, values] of [[0, g.positions], [1, g.normals]]) {
        gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
        gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
      }
      return array;
    }
    const square = { positions: new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, -1, 0, 1, 1, 0, -1, 1, 0]),
      normals: new Float32Array(18), count: 6 };
    const uploaded = new Map(), outlines = new Map();
    const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

    function mesh(g, model, how = gl.TRIANGLES) {
      if (!g.count) return;
      if (!uploaded.has(g)) uploaded.set(g, upload(g));
      gl.bindVertexArray(uploaded.get(g));
      gl.uniformMatrix4fv(at.model, false, model);
      gl.drawArrays(how, 0, g.count);
    }

    function edges(g, model) {
      if (!outlines.has(g)) outlines.set(g, outline(g));
      mesh(outlines.get(g), model, gl.LINES);
    }

    // Draws bodies half-transparent, over what is there: only their surface nearest to the eye shows. They are moved
    // back by half a millimetre, so that surfaces in the same place do not flicker.
    function ghost(bodies, poses, color) {
      gl.polygonOffset(1, 400);
      gl.colorMask(false, false, false, false);
      bodies.forEach((g, body) => mesh(g, poses[body]));
      gl.colorMask(true, true, true, true);
      gl.depthFunc(gl.LEQUAL);
      gl.uniform4fv(at.color, color);
      bodies.forEach((g, body) => mesh(g, poses[body]));
      gl.depthFunc(gl.LESS);
    }

    // Draws a frame of a replay into a 2D canvas of the page, at the canvas's size. shapes: whether to draw the
    // collision shapes, with the surfaces half-transparent over them.
    return function draw(onto, scene, r, frame, view, colors, shapes) {
      const width = onto.width, height = onto.height;
      if (canvas.width < width || canvas.height < height) {
        canvas.width = Math.max(canvas.width, width);
        canvas.height = Math.max(canvas.height, height);
      }
      const { matrix, eye } = camera(view, r.target, width / height);
      const top = r.stays || frame <= r.start ? scene.table.on : scene.table.lowered;
      gl.viewport(0, canvas.height - height, width, height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
      gl.uniformMatrix4fv(at.view, false, matrix);
      gl.uniform3fv(at.eye, eye);
      gl.uniform3fv(at.middle, r.target);
      const all = ({ hand, objects }) => [...hand, objects[r.object]];
      const bodies = all(shapes ? scene.shapes : scene), object = scene.hand.length;
      const poses = bodies.map((_, body) => pose(r, body, frame));
      gl.enable(gl.BLEND);
      gl.disable(gl.DEPTH_TEST);
      gl.uniform1i(at.kind, 2);
      gl.uniform4fv(at.color, colors.table);
      mesh(square, new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, r.target[0], r.target[1], top, 1]));
      // The stencil keeps overlapping shadows from adding up.
      gl.enable(gl.STENCIL_TEST);
      gl.stencilFunc(gl.EQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
      gl.uniform1i(at.kind, 1);
      gl.uniform4fv(at.color, colors.shadow);
      const flat = shadow(top);
      if (eye[2] > top) bodies.forEach((g, body) => mesh(g, times(flat, poses[body])));
      gl.disable(gl.STENCIL_TEST);
      gl.disable(gl.BLEND);
      gl.enable(gl.DEPTH_TEST);
      gl.uniform1i(at.kind, 0);
      const touching = r.c[Math.max(0, Math.min(r.n - 1, Math.round(frame)))];
      if (shapes) gl.enable(gl.POLYGON_OFFSET_FILL);
      gl.polygonOffset(1, 40);
      bodies.forEach((g, body) => {
        const kind = body === object ? "object" : (touching >> body) & 1 ? "contact" : "hand";
        gl.uniform4fv(at.color, colors[kind]);
        mesh(g, poses[body]);
      });
      if (shapes) {
        gl.enable(gl.BLEND);
        gl.uniform1i(at.kind, 1);
        gl.uniform4fv(at.color, colors.edge);
        bodies.forEach((g, body) => edges(g, poses[body]));
        gl.uniform1i(at.kind, 0);
        ghost(all(scene), poses, colors.ghost);
        gl.disable(gl.POLYGON_OFFSET_FILL);
      }
      gl.enable(gl.BLEND);
      if (r.bodies > object + 1) {
        gl.depthMask(false);
        gl.uniform1i(at.kind, 1);
        gl.uniform4fv(at.color, [...colors.object.slice(0, 3), 0.22]);
        mesh(bodies[object], pose(r, object + 1, frame));
        gl.depthMask(true);
      }
      const flatCanvas = onto.getContext("2d");
      flatCanvas.clearRect(0, 0, width, height);
      flatCanvas.drawImage(canvas, 0, 0, width, height, 0, 0, width, height);
    };
  }

  return { bytes, geometry, outline, decode, pose, seconds, lossFrame, times, camera, shadow, readHash, painter };
})();

if (typeof module !== "undefined") module.exports = Replays;
