// The situation map: one canvas layer that draws a scene (what stays) and frames (what moves).
// Coordinates are metres east/north of the scenario's origin. Colours come from the page's CSS variables.
// Browsers and the server may call a method before the map is mounted and after it is gone (a canvas that is taken away
// sends a last pointerleave). What is shown is reactive data, which takes that; what draws or points asks `context`
// (there from mounted to unmounted) or `view` (there once something can be seen).
const EARTH_M = 40075016.686;
const RAMP = [[0, 32, 77], [64, 77, 107], [124, 123, 120], [188, 175, 111], [255, 234, 70]]; // cividis

const LEAST_HZ = 10; // a link with less carries nothing worth a line
const LEAST_BPS = 100; // a user with less is not served

function ramp(share) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(at), RAMP.length - 2);
  const mix = RAMP[low].map((value, i) => Math.round(value + (at - low) * (RAMP[low + 1][i] - value)));
  return `rgb(${mix})`;
}

function niceStep(span) {
  const raw = span / 6;
  const ten = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].find((k) => k * ten >= raw) * ten;
}

export default {
  template: `
    <div class="sf-map" tabindex="0" role="application" :aria-label="label" @keydown="onKey"
      :data-frames="frames || null" :data-lost="lost" :data-uavs="frame?.uavs.length">
      <canvas ref="canvas" aria-hidden="true"
        @pointerdown="onDown" @pointermove="onMove" @pointerup="onUp" @pointercancel="onCancel" @pointerleave="onLeave"
        @wheel.prevent="onWheel"></canvas>
      <div class="sf-map-tip" v-show="tip" :style="tip?.place">{{ tip?.words }}</div>
      <div class="sf-map-tools">
        <button type="button" aria-label="zoom in" @click="zoomBy(1.4)">+</button>
        <button type="button" aria-label="zoom out" @click="zoomBy(1 / 1.4)">&minus;</button>
        <button type="button" aria-label="show the whole area" @click="fit()"><svg width="16" height="16" viewBox="0 0 16 16" aria-hidden="true"><path d="M1 5V1h4M11 1h4v4M15 11v4h-4M5 15H1v-4" fill="none" stroke="currentColor" stroke-width="2"/></svg></button>
      </div>
    </div>`,
  props: { label: String, tool: String },
  data: () => ({ scene: null, frame: null, frames: 0, selected: null, tip: null }),
  computed: {
    lost() {
      return this.frame?.uavs.filter((uav) => uav.lost).map((uav) => uav.id).join(" ");
    },
  },
  created() {
    this.context = null;
    this.view = null;
    this.tracks = {};
    this.tiles = new Map();
    this.pointers = new Map();
    this.drag = null;
  },
  mounted() {
    this.canvas = this.$refs.canvas;
    this.context = this.canvas.getContext("2d");
    this.watcher = new ResizeObserver(() => this.resize());
    this.watcher.observe(this.$el);
    this.themes = new MutationObserver(() => this.readColours());
    this.themes.observe(document.body, { attributes: true, attributeFilter: ["class"] });
    this.readColours();
    this.resize();
  },
  beforeUnmount() {
    this.watcher.disconnect();
    this.themes.disconnect();
    cancelAnimationFrame(this.asked);
    for (const image of this.tiles.values()) image.onload = null;
    this.context = this.view = this.drag = null;
  },
  methods: {
    // --- what the server calls ---
    set_scene(scene, tracks) {
      const moved = !this.scene || JSON.stringify(this.scene.area) !== JSON.stringify(scene.area);
      this.scene = Object.freeze(scene);
      if (tracks) this.tracks = tracks;
      if (moved) this.fit(false);
      this.draw();
    },
    set_frame(frame) {
      this.frame = Object.freeze(frame);
      this.frames += 1;
      if (frame.live) for (const uav of frame.uavs) this.follow(uav);
      this.draw();
    },
    select(id) {
      this.selected = id;
      this.draw();
    },
    follow(uav) {
      if (uav.e === null || uav.lost) return;
      const track = (this.tracks[uav.id] ??= []);
      const last = track[track.length - 1];
      if (!last || Math.hypot(last[0] - uav.e, last[1] - uav.n) >= 0.5) track.push([uav.e, uav.n]);
      if (track.length > 4000) track.splice(0, 1000);
    },

    // --- the view ---
    readColours() {
      const style = getComputedStyle(document.body);
      const get = (name) => style.getPropertyValue(`--sf-${name}`).trim();
      this.colours = Object.fromEntries(
        ["map", "grid", "text", "muted", "line", "accent", "alarm", "warn", "zone", "panel"].map((n) => [n, get(n)]),
      );
      this.palette = get("uavs").split(" ");
      this.draw();
    },
    resize() {
      if (!this.context) return;
      const scale = window.devicePixelRatio || 1;
      const { clientWidth: w, clientHeight: h } = this.$el;
      if (!w || !h) return;
      this.canvas.width = Math.round(w * scale);
      this.canvas.height = Math.round(h * scale);
      this.size = { w, h, scale };
      if (this.scene) (this.view?.touched ? this.draw() : this.fit(false));
    },
    fit() {
      if (!this.scene || !this.size || !this.context) return;
      const [[west, south], [east, north]] = this.scene.area;
      const { w, h } = this.size;
      const zoom = Math.min((w - 56) / (east - west), (h - 56) / (north - south));
      this.view = { e: (west + east) / 2, n: (south + north) / 2, zoom, touched: false };
      this.draw();
    },
    zoomBy(factor, x = this.size?.w / 2, y = this.size?.h / 2) {
      if (!this.view) return;
      const [e, n] = this.ground(x, y);
      const zoom = Math.min(Math.max(this.view.zoom * factor, 1e-3), 200);
      this.view = { zoom, e: e - (x - this.size.w / 2) / zoom, n: n + (y - this.size.h / 2) / zoom, touched: true };
      this.draw();
    },
    pan(dx, dy) {
      if (!this.view) return;
      this.view = { ...this.view, e: this.view.e - dx / this.view.zoom, n: this.view.n + dy / this.view.zoom, touched: true };
      this.draw();
    },
    at(e, n) {
      const { w, h } = this.size;
      return [w / 2 + (e - this.view.e) * this.view.zoom, h / 2 - (n - this.view.n) * this.view.zoom];
    },
    ground(x, y) {
      const { w, h } = this.size;
      return [this.view.e + (x - w / 2) / this.view.zoom, this.view.n - (y - h / 2) / this.view.zoom];
    },
    users() { // [id, east, north, radius in which it is], now
      return this.scene.users.map(([id, e, n]) => [id, ...(this.frame?.users?.[id] ?? [e, n, 0])]);
    },
    colour(id) {
      return this.palette[Math.max(this.scene.uavs.indexOf(id), 0) % this.palette.length];
    },

    // --- drawing ---
    draw() {
      if (!this.context || this.asked) return;
      this.asked = requestAnimationFrame(() => {
        this.asked = null;
        this.paint();
      });
    },
    paint() {
      const c = this.context;
      if (!c || !this.size || !this.view || !this.scene) return;
      c.setTransform(this.size.scale, 0, 0, this.size.scale, 0, 0);
      c.fillStyle = this.colours.map;
      c.fillRect(0, 0, this.size.w, this.size.h);
      this.paintTiles(c);
      this.paintGrid(c);
      this.paintZones(c);
      this.paintUserTracks(c);
      this.paintPlans(c);
      this.paintTracks(c);
      if (this.frame) this.paintReserved(c);
      if (this.frame) this.paintLinks(c);
      this.paintUsers(c);
      this.paintPins(c);
      if (this.frame) for (const uav of this.frame.uavs) this.paintUav(c, uav);
      this.nameUsers();
      if (this.frame) for (const uav of this.frame.uavs) this.nameUav(uav); // over everything: it matters most
      this.paintLegend(c);
    },
    line(points, { colour, width = 1.5, dash = [], alpha = 1 }) {
      const c = this.context;
      if (points.length < 2) return;
      c.save();
      Object.assign(c, { strokeStyle: colour, lineWidth: width, globalAlpha: alpha, lineJoin: "round", lineCap: "round" });
      c.setLineDash(dash);
      c.beginPath();
      for (const [e, n] of points) c.lineTo(...this.at(e, n));
      c.stroke();
      c.restore();
    },
    text(string, x, y, { colour = this.colours.text, size = 11, align = "left", weight = 400, halo = true } = {}) {
      const c = this.context;
      c.font = `${weight} ${size}px Roboto, system-ui, sans-serif`;
      c.textAlign = align;
      if (halo) {
        Object.assign(c, { strokeStyle: this.colours.map, lineWidth: 3, lineJoin: "round" });
        c.strokeText(string, x, y);
      }
      c.fillStyle = colour;
      c.fillText(string, x, y);
    },
    paintTiles(c) {
      const { tiles, origin } = this.scene;
      if (!tiles) return;
      const rad = (origin.lat_deg * Math.PI) / 180;
      const perMetre = 1 / (EARTH_M * Math.cos(rad)); // of the unit Mercator square
      const x0 = origin.lon_deg / 360 + 0.5;
      const y0 = 0.5 - Math.log(Math.tan(Math.PI / 4 + rad / 2)) / (2 * Math.PI);
      const z = Math.min(Math.max(Math.round(Math.log2(this.view.zoom / perMetre / 256)), 0), 19);
      const side = 2 ** -z;
      const [west, north] = this.ground(0, 0);
      const [east, south] = this.ground(this.size.w, this.size.h);
      const px = (side / perMetre) * this.view.zoom;
      for (let i = Math.floor((x0 + west * perMetre) / side); i <= Math.floor((x0 + east * perMetre) / side); i++) {
        for (let j = Math.floor((y0 - north * perMetre) / side); j <= Math.floor((y0 - south * perMetre) / side); j++) {
          const image = this.tile(tiles.replace("{z}", z).replace("{x}", i).replace("{y}", j));
          const [x, y] = this.at((i * side - x0) / perMetre, (y0 - j * side) / perMetre);
          if (image.complete && image.naturalWidth) c.drawImage(image, x, y, px + 0.5, px + 0.5);
        }
      }
    },
    tile(url) {
      if (!this.tiles.has(url)) {
        const image = new Image();
        image.onload = () => this.draw();
        image.src = url;
        this.tiles.set(url, image);
      }
      return this.tiles.get(url);
    },
    paintGrid(c) {
      const [[west, south], [east, north]] = this.scene.area;
      const step = niceStep(Math.min(this.size.w, this.size.h) / this.view.zoom);
      const [left, top] = this.ground(0, 0);
      const [right, bottom] = this.ground(this.size.w, this.size.h);
      c.lineWidth = 1;
      c.strokeStyle = this.colours.grid;
      c.beginPath();
      for (let e = Math.ceil(left / step) * step; e <= right; e += step) {
        const x = Math.round(this.at(e, 0)[0]) + 0.5;
        c.moveTo(x, 0);
        c.lineTo(x, this.size.h);
      }
      for (let n = Math.ceil(bottom / step) * step; n <= top; n += step) {
        const y = Math.round(this.at(0, n)[1]) + 0.5;
        c.moveTo(0, y);
        c.lineTo(this.size.w, y);
      }
      c.stroke();
      const label = { colour: this.colours.muted, size: 10 };
      for (let e = Math.ceil(left / step) * step; e <= right; e += step) {
        const x = this.at(e, 0)[0];
        if (x < this.size.w - 90) this.text(`${Math.round(e)} E`, x + 3, this.size.h - 5, label);
      }
      for (let n = Math.ceil(bottom / step) * step; n <= top; n += step) {
        const y = this.at(0, n)[1];
        if (y < this.size.h - 20) this.text(`${Math.round(n)} N`, 4, y - 3, label);
      }
      const corners = [[west, south], [east, south], [east, north], [west, north], [west, south]];
      this.line(corners, { colour: this.colours.accent, width: 2 }); // the geofence: constraint (6c)'s area
    },
    paintZones(c) {
      for (const zone of this.scene.no_fly) {
        c.save();
        c.beginPath();
        if (zone.kind === "disc") {
          const [x, y] = this.at(...zone.center_m);
          c.arc(x, y, zone.radius_m * this.view.zoom, 0, 2 * Math.PI);
        } else {
          for (const vertex of zone.vertices_m) c.lineTo(...this.at(...vertex));
          c.closePath();
        }
        c.globalAlpha = 0.18;
        c.fillStyle = this.colours.zone;
        c.fill();
        c.globalAlpha = 1;
        c.clip();
        Object.assign(c, { strokeStyle: this.colours.zone, lineWidth: 1 });
        c.beginPath();
        const { w, h } = this.size;
        for (let x = -h; x < w; x += 9) {
          c.moveTo(x, h);
          c.lineTo(x + h, 0);
        }
        c.globalAlpha = 0.55;
        c.stroke();
        c.restore();
        const [e, n] = zone.kind === "disc" ? zone.center_m : zone.vertices_m[0];
        this.text("NO FLY", ...this.at(e, n), { colour: this.colours.zone, align: "center", weight: 600, size: 10 });
      }
    },
    paintUserTracks(c) {
      for (const track of Object.values(this.scene.user_tracks ?? {})) {
        this.line(track, { colour: this.colours.muted, width: 1.2, dash: [2, 3], alpha: 0.8 });
      }
      for (const [, e, n, radius] of this.users()) {
        if (!radius) continue;
        const [x, y] = this.at(e, n);
        c.save();
        c.beginPath();
        c.arc(x, y, radius * this.view.zoom, 0, 2 * Math.PI);
        Object.assign(c, { fillStyle: this.colours.muted, strokeStyle: this.colours.muted, lineWidth: 1, globalAlpha: 0.12 });
        c.fill();
        c.globalAlpha = 0.6;
        c.setLineDash([3, 3]);
        c.stroke();
        c.restore();
      }
    },
    paintPlans() {
      for (const plan of this.scene.plans) {
        for (const [id, path] of Object.entries(plan.paths)) {
          const dimmed = this.selected && this.selected !== id;
          const style = plan.style === "former" ? { dash: [1, 5], alpha: 0.55 } : { dash: plan.style === "other" ? [2, 4] : [7, 5] };
          this.line(path, { colour: this.colour(id), width: this.selected === id ? 2.5 : 1.5, ...style, ...(dimmed && { alpha: 0.25 }) });
          if (plan.style === "former") continue;
          const [x, y] = this.at(...path[path.length - 1]);
          const c = this.context;
          c.save();
          Object.assign(c, { strokeStyle: this.colour(id), lineWidth: 1.5, globalAlpha: dimmed ? 0.3 : 1 });
          c.strokeRect(x - 3.5, y - 3.5, 7, 7);
          c.restore();
        }
      }
    },
    paintTracks() {
      for (const [id, track] of Object.entries(this.tracks)) {
        const dimmed = this.selected && this.selected !== id;
        this.line(track, { colour: this.colour(id), width: 3, alpha: dimmed ? 0.3 : 0.85 });
      }
    },
    paintReserved() {
      for (const uav of this.frame.uavs) {
        if (!uav.lost || uav.e === null) continue;
        const route = this.scene.reserved[uav.id] ?? [];
        const width = Math.max(2 * this.scene.d_min * this.view.zoom, 8);
        this.line([[uav.e, uav.n], ...route], { colour: this.colours.alarm, width, alpha: 0.16 });
        this.line([[uav.e, uav.n], ...route], { colour: this.colours.alarm, width: 1.2, dash: [3, 4], alpha: 0.9 });
      }
    },
    paintLinks(c) {
      const where = Object.fromEntries(this.frame.uavs.map((uav) => [uav.id, uav]));
      const widest = Math.max(...this.frame.links.map((link) => link[2]), 1);
      const write = this.frame.links.length <= 24;
      const places = Object.fromEntries(this.users().map((user) => [user[0], user]));
      for (const [served, id, hz] of this.frame.links) {
        const uav = where[id];
        const user = places[served];
        if (!uav || !user || uav.e === null || hz < LEAST_HZ) continue;
        const off = uav.lost;
        const dimmed = this.selected && this.selected !== id;
        const style = { colour: off ? this.colours.alarm : this.colour(id), width: 1 + (3 * hz) / widest, dash: off ? [2, 5] : [] };
        this.line([[uav.e, uav.n], [user[1], user[2]]], { ...style, alpha: dimmed ? 0.12 : 0.5 });
        if (!write || dimmed || off) continue;
        const [x1, y1] = this.at(uav.e, uav.n);
        const [x2, y2] = this.at(user[1], user[2]);
        if (Math.hypot(x1 - x2, y1 - y2) < 46) continue;
        this.text(`${(hz / 1e3).toFixed(1)} kHz`, (x1 + 2 * x2) / 3, (y1 + 2 * y2) / 3 - 2, { size: 10, align: "center", colour: this.colours.muted });
      }
      c.globalAlpha = 1;
    },
    paintUsers(c) {
      const rates = this.frame?.rates ?? {};
      const cut = new Set(this.frame?.cut ?? []);
      const r = this.scene.users.length > 60 ? 5 : 7;
      const absent = new Set(this.frame?.absent ?? []);
      this.users().forEach(([id, e, n]) => {
        const [x, y] = this.at(e, n);
        c.globalAlpha = absent.has(id) ? 0.25 : 1;
        const rate = rates[id] ?? null;
        const off = cut.has(id);
        const idle = rate !== null && rate < LEAST_BPS && !off;
        c.beginPath();
        c.arc(x, y, r, 0, 2 * Math.PI);
        c.fillStyle = rate === null ? this.colours.panel : off || idle ? this.colours.map : ramp(rate / this.scene.rate_max);
        c.fill();
        Object.assign(c, { lineWidth: off ? 2.5 : 1.5, strokeStyle: off ? this.colours.alarm : idle ? this.colours.muted : this.colours.text });
        c.stroke();
        if (!off) return;
        c.beginPath();
        c.moveTo(x - 3, y - 3);
        c.lineTo(x + 3, y + 3);
        c.moveTo(x + 3, y - 3);
        c.lineTo(x - 3, y + 3);
        c.stroke();
      });
      c.globalAlpha = 1;
    },
    paintPins(c) {
      const pinned = new Set(this.scene.pinned ?? []);
      for (const [id, e, n] of this.users()) if (pinned.has(id)) this.pin(c, ...this.at(e, n), 7);
      for (const uav of this.frame?.uavs ?? []) if (uav.e !== null && pinned.has(uav.id)) this.pin(c, ...this.at(uav.e, uav.n), 13);
    },
    pin(c, x, y, out) {
      const [px, py] = [x - out, y - out - 3];
      c.beginPath();
      c.moveTo(px, py + 8);
      c.lineTo(px, py);
      Object.assign(c, { strokeStyle: this.colours.text, lineWidth: 1.5, fillStyle: this.colours.accent });
      c.stroke();
      c.beginPath();
      c.arc(px, py - 2, 3.5, 0, 2 * Math.PI);
      c.fill();
      c.stroke();
    },
    nameUsers() {
      if (this.scene.users.length > 40 && this.view.zoom < 3) return;
      const rates = this.frame?.rates ?? {};
      const cut = new Set(this.frame?.cut ?? []);
      this.users().forEach(([id, e, n]) => {
        const [x, y] = this.at(e, n);
        const rate = rates[id] ?? null;
        const name = id.replace(/^user-/, "u");
        const words = rate === null ? name : cut.has(id) ? `${name} NO SERVICE` : rate < LEAST_BPS ? name : `${name} ${(rate / 1e3).toFixed(1)}`;
        const strong = cut.has(id) ? { colour: this.colours.alarm, weight: 700 } : {};
        this.text(words, x, y + 19, { size: 10, align: "center", ...strong });
      });
    },
    paintUav(c, uav) {
      if (uav.e === null) return;
      const [x, y] = this.at(uav.e, uav.n);
      const many = this.frame.uavs.length > 16;
      const big = many && this.selected !== uav.id ? 8 : 11;
      c.save();
      c.translate(x, y);
      c.rotate(((uav.heading ?? 0) * Math.PI) / 180);
      c.beginPath();
      c.moveTo(0, -big * 1.25);
      c.lineTo(big * 0.85, big);
      c.lineTo(0, big * 0.5);
      c.lineTo(-big * 0.85, big);
      c.closePath();
      if (uav.lost) {
        c.setLineDash([3, 3]);
        Object.assign(c, { strokeStyle: this.colours.alarm, lineWidth: 2, fillStyle: this.colours.map, globalAlpha: 0.9 });
        c.fill();
        c.stroke();
      } else {
        Object.assign(c, { fillStyle: this.colour(uav.id), strokeStyle: this.colours.map, lineWidth: 2 });
        c.stroke();
        c.fill();
        if (uav.link === "stale") {
          c.setLineDash([4, 3]);
          Object.assign(c, { strokeStyle: this.colours.warn, lineWidth: 2.5 });
          c.beginPath();
          c.arc(0, 0, big + 7, 0, 2 * Math.PI);
          c.stroke();
        }
      }
      c.restore();
      if (this.selected === uav.id) {
        c.beginPath();
        c.arc(x, y, big + 9, 0, 2 * Math.PI);
        Object.assign(c, { strokeStyle: this.colours.text, lineWidth: 1.5 });
        c.stroke();
      }
    },
    nameUav(uav) {
      if (uav.e === null) return;
      const [x, y] = this.at(uav.e, uav.n);
      const many = this.frame.uavs.length > 16;
      const short = uav.id.replace(/^uav-/, "");
      if (many && this.selected !== uav.id && !uav.lost && uav.link !== "stale") {
        if (this.view.zoom * 40 > 12) this.text(short, x + 9, y - 6, { size: 9 });
        return;
      }
      const side = x > this.size.w - 150 ? -1 : 1;
      const align = side > 0 ? "left" : "right";
      const colour = uav.lost ? this.colours.alarm : this.colours.text;
      this.text(uav.lost ? `${uav.id} LOST` : uav.id, x + side * 16, y - 8, { weight: 700, size: 12, align, colour });
      const parts = [];
      if (uav.age !== null) parts.push(`♥ ${uav.age.toFixed(1)} s`);
      if (uav.battery !== null) parts.push(`${Math.round(uav.battery)} %`);
      if (uav.alt !== null) parts.push(`${uav.alt.toFixed(0)} m`);
      if (parts.length) this.text(parts.join("  "), x + side * 16, y + 5, { size: 10, align, colour: uav.link === "live" ? this.colours.muted : colour });
    },
    paintLegend(c) {
      if (!this.scene.rate_max) return;
      const { w, h } = this.size;
      const wide = 120;
      const x = w - wide - 14;
      const y = h - 46;
      c.globalAlpha = 0.88;
      c.fillStyle = this.colours.panel;
      c.fillRect(x - 8, y - 16, wide + 16, 58);
      c.globalAlpha = 1;
      const fill = c.createLinearGradient(x, 0, x + wide, 0);
      for (let i = 0; i <= 8; i++) fill.addColorStop(i / 8, ramp(i / 8));
      c.fillStyle = fill;
      c.fillRect(x, y, wide, 8);
      const plain = { halo: false, size: 10, colour: this.colours.text };
      this.text("user rate, kbit/s", x, y - 4, plain);
      this.text("0", x, y + 19, plain);
      this.text((this.scene.rate_max / 1e3).toFixed(0), x + wide, y + 19, { ...plain, align: "right" });
      c.beginPath();
      c.arc(x + 5, y + 32, 4, 0, 2 * Math.PI);
      Object.assign(c, { strokeStyle: this.colours.muted, lineWidth: 1.5 });
      c.stroke();
      this.text("not served", x + 14, y + 36, plain);
    },

    // --- pointing ---
    hit(x, y) {
      const close = (e, n, r) => {
        const [px, py] = this.at(e, n);
        return Math.hypot(px - x, py - y) <= r;
      };
      const uav = this.frame?.uavs.find((each) => each.e !== null && close(each.e, each.n, 15));
      if (uav) return { kind: "uav", id: uav.id, uav };
      const user = this.scene && this.users().find((each) => close(each[1], each[2], 11));
      return user ? { kind: "user", id: user[0] } : null;
    },
    onDown(event) {
      if (!this.view) return;
      this.canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
      const target = this.hit(event.offsetX, event.offsetY);
      this.drag = { x: event.offsetX, y: event.offsetY, far: 0, target: this.tool ? target : null, hit: target };
    },
    onMove(event) {
      if (!this.view) return;
      const { offsetX: x, offsetY: y } = event;
      const before = this.pointers.get(event.pointerId);
      if (!before) return this.showTip(x, y);
      if (this.pointers.size === 2) return this.pinch(event.pointerId, [x, y]);
      this.pointers.set(event.pointerId, [x, y]);
      if (!this.drag) return; // one of two fingers was lifted: the other one drags nothing
      this.drag.far = Math.max(this.drag.far, Math.hypot(x - this.drag.x, y - this.drag.y));
      if (this.drag.far > 4 && !this.drag.target) this.pan(x - before[0], y - before[1]);
    },
    pinch(id, here) {
      const other = [...this.pointers.entries()].find(([each]) => each !== id)[1];
      const was = this.pointers.get(id);
      const apart = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      this.zoomBy(apart(here) / apart(was), (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
      this.pointers.set(id, here);
      if (this.drag) this.drag.far = 99;
    },
    onUp(event) {
      this.pointers.delete(event.pointerId);
      const drag = this.drag;
      this.drag = null;
      if (!drag || !this.view) return;
      const [e, n] = this.ground(event.offsetX, event.offsetY).map((metres) => Math.round(metres * 10) / 10);
      if (drag.far <= 4 && drag.hit && this.tool !== "remove") this.$emit("pick", { kind: drag.hit.kind, id: drag.hit.id });
      else if (drag.far <= 4 && this.tool) this.$emit("place", { tool: this.tool, e, n, kind: drag.hit?.kind, id: drag.hit?.id });
      else if (drag.far > 4 && drag.target) this.$emit("moved", { kind: drag.target.kind, id: drag.target.id, e, n });
    },
    onCancel(event) {
      this.pointers.delete(event.pointerId);
      this.drag = null;
    },
    onLeave() {
      this.tip = null;
    },
    showTip(x, y) {
      const found = this.hit(x, y);
      this.canvas.style.cursor = found ? "pointer" : this.tool ? "crosshair" : "grab";
      const place = { left: `${Math.min(x + 14, this.size.w - 210)}px`, top: `${Math.min(y + 14, this.size.h - 80)}px` };
      this.tip = found && { words: found.kind === "uav" ? this.uavTip(found.uav) : this.userTip(found.id), place };
    },
    uavTip(uav) {
      const lines = [`${uav.id}: ${uav.state ?? ""}`, `heading ${Math.round(uav.heading ?? 0)}°, ${uav.alt?.toFixed(1) ?? "?"} m above home`];
      if (uav.age !== null) lines.push(`heartbeat ${uav.age.toFixed(1)} s ago`);
      if (uav.item !== null && uav.item !== undefined) lines.push(`mission item ${uav.item}`);
      return lines.join("\n");
    },
    userTip(id) {
      const link = this.frame?.links.find((each) => each[0] === id);
      const rate = this.frame?.rates[id];
      const lines = [id, rate === null || rate === undefined ? "rate unknown" : `${(rate / 1e3).toFixed(2)} kbit/s`];
      const most = this.frame?.asked?.[id];
      if (this.frame?.absent?.includes(id)) lines[1] = "not there in this slot";
      else if (most && rate >= most * (1 - 1e-6)) lines.push("has all it asked for");
      else if (most) lines.push(`asks for ${(most / 1e3).toFixed(2)} kbit/s`);
      if (link) lines.push(`served by ${link[1]} with ${(link[2] / 1e3).toFixed(2)} kHz`);
      return lines.join("\n");
    },
    onWheel(event) {
      this.zoomBy(Math.exp(-event.deltaY / 500), event.offsetX, event.offsetY);
    },
    onKey(event) {
      if (!this.view) return;
      const step = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[event.key];
      if (step) this.pan(...step);
      else if (event.key === "+" || event.key === "=") this.zoomBy(1.25);
      else if (event.key === "-") this.zoomBy(0.8);
      else if (event.key === "0") this.fit();
      else return;
      event.preventDefault();
    },
  },
};
