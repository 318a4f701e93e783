"use strict";
// The page of records: state, what is drawn from it, and the controls that change it.
(async () => {
  const by = (id) => document.getElementById(id);
  const { records } = JSON.parse(by("data").textContent);
  const PIXELS = 301; // of a map, per side
  const WIDE = 100; // a larger range of values begins in logarithms
  const DEEPEST = 1e-6; // of the largest value: the darkest colour
  const DECADES = 4; // of the lobe, where it is logarithmic
  const ROUNDING = 2 ** -24; // relative, of single precision
  const NORMAL = 1.96; // standard errors of half a 95 % interval
  const BAR = 85, MOST = 480; // pixels: width of a map's colour bar, largest map
  const FATES = ["reflection", "transmission"];
  const COLOURS = [["#1f77b4", "#ff7f0e"], ["#2ca02c", "#9467bd"]]; // record, hemisphere
  const state = { record: 0, beside: records.length > 1 ? 1 : -1, theta: 0, phi: 0, channel: 0, azimuth: 0 };
  const pointed = {}; // patch under the pointer, by map
  const radians = (degrees) => (degrees * Math.PI) / 180;
  const times = (n, of) => Array.from({ length: n }, (_, i) => of(i));
  const most = (values) => values.reduce((a, b) => (b > a ? b : a), 0);
  const short = (x) => (Number.isFinite(x) ? Number(x.toPrecision(5)).toString() : "unknown");

  // A number with as many digits as leave two of its error, and single precision has.
  function known(x, error) {
    if (!Number.isFinite(x) || !(error > 0)) return short(x);
    const size = Math.abs(x);
    const places = 1 - Math.floor(Math.log10(Math.max(error, ROUNDING * size)));
    const within = (n, limit) => Math.min(Math.max(n, 0), limit);
    if (size > 0 && (size < 1e-4 || size >= 1e7))
      return x.toExponential(within(Math.floor(Math.log10(size)) + places, 7));
    return x.toFixed(within(places, 12));
  }

  // The error of a number, or the rounding in which it is lost.
  function uncertain(x, error) {
    const rounding = ROUNDING * Math.abs(x);
    return error > 0 && error < rounding ? `<${known(rounding, rounding)}` : known(error, error);
  }

  // ------------------------------------------------------------------ the numbers
  async function inflated(text) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }

  for (const one of records) {
    for (const name of ["solid", "theta", "phi"])
      one[name] = new Float32Array(await inflated(one[name]));
    one.raster = new Uint32Array(await inflated(one.raster));
  }

  // Number of the direction that is chosen: `rings` has them by polar angle and azimuth.
  const chosen = (one) => one.rings[state.theta].at(Math.min(state.phi, one.rings[state.theta].length - 1));

  // A record at one of its directions, as everything below looks at it.
  async function look(one, index) {
    const raw = await inflated(one.values[index]), n = one.hemispheres * one.patches * one.channels.length;
    const part = (k) => new Float32Array(raw, 4 * k * n, n);
    return { one, direction: one.directions[index], mean: part(0), error: part(1),
             below: part(2), above: part(3), hits: new Uint32Array(raw, 16 * n) };
  }

  function patchAt(one, theta, phi) {
    const [rows, columns] = one.raster_shape;
    const row = Math.min(rows - 1, Math.floor((theta / 90) * rows));
    const turn = (((phi / 360) % 1) + 1) % 1;
    return one.raster[row * columns + (Math.floor(turn * columns) % columns)];
  }

  // What is known of one patch in the channel that is chosen.
  function reading({ one, ...values }, hemisphere, patch) {
    const place = hemisphere * one.patches + patch, n = one.channels.length;
    const at = place * n + Math.min(state.channel, n - 1);
    const mean = values.mean[at], hits = values.hits[place];
    return { mean, error: values.error[at], low: mean - values.below[at], hits,
             high: mean + values.above[at], solid: one.solid[patch], theta: one.theta[patch],
             phi: one.phi[patch], exact: one.integrals && !hits }; // nothing is left to chance
  }

  const readings = (from, h) => times(from.one.detectors, (patch) => reading(from, h, patch));

  // Difference of two means in standard errors. Where no ray came, the upper limit tells.
  function difference(a, b) {
    const spread = (r) => (r.error > 0 ? r.error : (r.high - r.mean) / NORMAL);
    const rounding = ROUNDING * Math.max(a.mean, b.mean);
    return a.mean === b.mean ? 0 : (a.mean - b.mean) / Math.hypot(spread(a), spread(b), rounding);
  }

  // ------------------------------------------------------------------ the maps
  const axis = times(PIXELS, (i) => -1 + (2 * i) / (PIXELS - 1));
  // Patch under each pixel, -1 beside the disc; once for each record.
  function pixels(one) {
    one.pixels ??= axis.map((y) => axis.map((x) => {
      const radius = Math.hypot(x, y);
      if (radius >= 1) return -1;
      const patch = patchAt(one, Math.asin(radius) / radians(1), Math.atan2(y, x) / radians(1));
      return patch < one.detectors ? patch : -1;
    }));
    return one.pixels;
  }

  const circle = (r) => ({ type: "circle", x0: -r, x1: r, y0: -r, y1: r,
                           line: { color: r < 1 ? "#fff" : "#333", width: r < 1 ? 0.5 : 1 } });

  // The polar angle of a circle within the horizon.
  const degrees = (r) => ({ text: `${Math.round(Math.asin(r) / radians(1))}\u00b0`, showarrow: false,
                            x: r * Math.cos(radians(75)), y: r * Math.sin(radians(75)), borderpad: 1,
                            font: { size: 10, color: "#fff" }, bgcolor: "#0008" });
  const RINGS = [0.5, Math.sqrt(0.75)]; // sines of 30 and 60 degrees

  // An azimuth of exit at the horizon; 0 is along +x.
  const azimuthLabel = (phi) => ({ text: `${phi ? "" : "\u03c6 "}${phi}\u00b0`, showarrow: false, borderpad: 0,
                                   x: 1.03 * Math.cos(radians(phi)), y: 1.03 * Math.sin(radians(phi)),
                                   xanchor: { 0: "left", 180: "right" }[phi] ?? "center",
                                   yanchor: { 90: "bottom", 270: "top" }[phi] ?? "middle", font: { size: 10 } });
  const AZIMUTHS = [0, 90, 180, 270];

  function towards(theta, phi) {
    const [t, p] = [theta, phi].map(radians);
    return [Math.sin(t) * Math.cos(p), Math.sin(t) * Math.sin(p), Math.cos(t)];
  }

  // Where the light comes from, and where a smooth specimen would send it.
  function marks({ theta_i, phi_i }, hemisphere) {
    if (theta_i === null) return [];
    const [x, y] = towards(theta_i, phi_i), kept = (pair) => pair.slice(hemisphere);
    const symbol = kept(["circle-open", "diamond-open"]);
    return [{ type: "scatter", mode: "markers", hoverinfo: "skip", showlegend: false, x: kept([x, -x]),
              y: kept([y, -y]), marker: { symbol, color: "#d62728", size: 11, line: { width: 2 } } }];
  }

  function colours(values, name) {
    const positive = values.filter((v) => v > 0), top = most(positive) || 1;
    const colorbar = { title: { text: name, side: "right" } };
    if (!by("logarithmic").checked) return { shown: (v) => v, zmin: 0, zmax: top, colorbar };
    const least = positive.reduce((a, b) => Math.min(a, b), top), zmax = Math.log10(top);
    const zmin = Math.floor(Math.log10(Math.max(least, DEEPEST * top)));
    const tickvals = times(Math.floor(zmax) - zmin + 1, (i) => zmin + i);
    return { shown: (v) => (v > 0 ? Math.log10(v) : null), zmin, zmax,
             colorbar: { ...colorbar, tickvals, ticktext: tickvals.map((t) => `1e${t}`) } };
  }

  function told(r, patch, apart) {
    const [mean, low, high] = [r.mean, r.low, r.high].map((x) => known(x, r.error));
    return [
      `\u03b8 ${short(r.theta)}\u00b0, \u03c6 ${short(r.phi)}\u00b0: ${mean} \u00b1 ${uncertain(r.mean, r.error)} 1/sr`,
      r.exact ? "\u00b1 is the largest error that the integral is estimated to have"
        : `\u00b1 is one standard error; 95 % interval ${low} to ${high}`,
      `${r.exact ? "integrated" : `${r.hits} rays`}, solid angle ${short(r.solid)} sr, patch ${patch}`,
      ...(apart ? [`${short(apart[patch])} standard errors apart`] : [])].join("\n");
  }

  // The panel of a map, which stays when it is drawn again.
  function panel({ key, heading }) {
    const found = by(key) ?? by("panel").content.firstElementChild.cloneNode(true);
    found.id = key;
    found.querySelector("h2").textContent = heading;
    return found;
  }

  async function drawMap({ key, from, hemisphere, known, shown, apart, ...picture }) {
    const plot = by(key).querySelector(".plot"), output = by(key).querySelector("output");
    const values = known.map(shown), width = Math.min(plot.clientWidth, MOST);
    const z = pixels(from.one).map((row) => row.map((patch) => values[patch] ?? null));
    const plain = () => ({ visible: false, range: [-1.22, 1.22] });
    const map = { type: "heatmap", x: axis, y: axis, z, hoverinfo: "none", zsmooth: false,
                  colorscale: "Viridis", ...picture, colorbar: { thickness: 14, ...picture.colorbar } };
    await Plotly.react(plot, [map, ...marks(from.direction, hemisphere)], {
      width, height: width - BAR + 40, margin: { l: 5, r: BAR, t: 32, b: 5, autoexpand: false },
      shapes: [...RINGS, 1].map(circle), annotations: [...RINGS.map(degrees), ...AZIMUTHS.map(azimuthLabel)], plot_bgcolor: "#fff", hovermode: "closest",
      xaxis: plain(), yaxis: { ...plain(), scaleanchor: "x" } }, { displaylogo: false });
    const tell = (patch) => { output.textContent = told(known[patch], patch, apart); };
    if (key in pointed) tell(pointed[key]); // in its new state
    plot.removeAllListeners("plotly_hover");
    plot.on("plotly_hover", ({ points: [at] }) => {
      const index = (v) => Math.round(((v + 1) / 2) * (PIXELS - 1));
      const patch = pixels(from.one)[index(at.y)]?.[index(at.x)] ?? -1;
      if (patch >= 0) tell((pointed[key] = patch));
    });
  }

  // The maps of one hemisphere, side by side: of each record, and of their difference.
  function mapsOf(looks, hemisphere) {
    const has = looks.filter((from) => hemisphere < from.one.hemispheres);
    const of = has.map((from) => readings(from, hemisphere));
    const scale = colours(of.flat().map((r) => r.mean), hemisphere ? "BTDF (1/sr)" : "BRDF (1/sr)");
    const maps = has.map((from, i) => ({
      ...scale, key: `map-${looks.indexOf(from)}-${hemisphere}`, from, hemisphere, known: of[i],
      heading: FATES[hemisphere] + (looks.length > 1 ? `: ${from.one.title}` : ""),
      shown: (r) => scale.shown(r.hits ? r.mean : r.mean || null) }));
    if (has.length === 2 && comparable(looks)) {
      const apart = of[0].map((r, patch) => difference(r, of[1][patch]));
      maps.push({
        key: `map-z-${hemisphere}`, from: has[0], hemisphere, known: of[0], apart,
        heading: `${FATES[hemisphere]}: difference`, zmin: -5, zmax: 5, colorscale: "RdBu",
        shown: (_, patch) => (Number.isFinite(apart[patch]) ? apart[patch] : null),
        colorbar: { title: { text: "std. errors", side: "right" }, tickvals: [-5, 0, 5],
                    ticktext: ["\u2264 -5", "0", "\u2265 5"] } });
    }
    return maps;
  }

  const comparable = ([{ one }, { one: other }]) =>
    one.collector === other.collector && one.channels.join() === other.channels.join();

  async function drawMaps(looks) {
    const rows = times(most(looks.map((from) => from.one.hemispheres)), (h) => mapsOf(looks, h));
    const maps = rows.flat(), several = looks.length > 1; // each row a hemisphere
    by("maps").style.setProperty("--columns", several ? most(rows.map((row) => row.length)) : 2);
    by("maps").replaceChildren(...maps.map(panel)); // all have their widths before any is drawn
    for (const map of maps) by(map.key).classList.toggle("first", several && rows.some(([one]) => one === map));
    for (const map of maps) await drawMap(map);
  }

  // ------------------------------------------------------------------ cut and lobe
  // Runs of one patch along a plane, from -90 to 90 degrees of theta.
  function runs(one, azimuth, phi_i) {
    const away = Math.cos(radians(azimuth - phi_i)) > 1e-9 ? 180 : 0;
    const n = one.raster_shape[0], found = [];
    for (let i = -n; i < n; i++) {
      const angle = ((i + 0.5) * 90) / n, last = found.at(-1);
      const patch = patchAt(one, Math.abs(angle), azimuth + away + (angle < 0 ? 180 : 0));
      if (last?.patch === patch) last.to = angle;
      else found.push({ patch, from: angle, to: angle });
    }
    return found.filter((run) => run.patch < one.detectors);
  }

  function curves(from, hemisphere, color, name) {
    const cut = runs(from.one, state.azimuth, from.direction.phi_i ?? 0)
      .map((run) => ({ ...reading(from, hemisphere, run.patch), at: (run.from + run.to) / 2 }));
    const lit = cut.filter((r) => r.mean !== 0), dark = cut.filter((r) => r.mean === 0 && r.high > 0);
    return [
      { type: "scatter", mode: "lines+markers", name, x: lit.map((r) => r.at), y: lit.map((r) => r.mean),
        marker: { size: 4, color }, line: { width: 0.7, color, shape: "hvh" },
        error_y: { type: "data", symmetric: false, thickness: 1, width: 2,
                   array: lit.map((r) => r.high - r.mean), arrayminus: lit.map((r) => r.mean - r.low) } },
      { type: "scatter", mode: "markers", name: `${name}, upper limit`, showlegend: false,
        x: dark.map((r) => r.at), y: dark.map((r) => r.high), marker: { size: 6, color, symbol: "triangle-down-open" } }];
  }

  async function drawCut(looks) {
    const several = looks.length > 1, type = by("logarithmic").checked ? "log" : "linear";
    const traces = looks.flatMap((from, i) =>
      FATES.slice(0, from.one.hemispheres).flatMap((fate, h) =>
        curves(from, h, COLOURS[i][h], several ? `${from.one.title}, ${fate}` : fate)));
    by("cut-value").textContent = `${state.azimuth}\u00b0`;
    by("azimuth").value = state.azimuth;
    await Plotly.react(by("cut"), traces, {
      width: by("cut").clientWidth, height: 340 + 10 * traces.length, margin: { l: 60, r: 10, t: 30, b: 40 },
      legend: { orientation: several ? "v" : "h", x: 0, y: -0.22, yanchor: "top" }, // clear of the toolbar
      xaxis: { range: [-93, 93], dtick: 30, ticksuffix: "\u00b0", title: { text: "\u03b8\u2092" } },
      yaxis: { type, title: { text: "1/sr" }, exponentformat: "e",
               rangemode: type === "log" ? "normal" : "tozero" } }, { displaylogo: false });
  }

  // One lobe for each record that is looked at, with its name if there are two.
  async function drawLobes(looks) {
    const place = by("lobes"), wanted = looks.map((_, i) => `lobe-${i}`);
    while (place.children.length > wanted.length) place.lastElementChild.remove();
    for (const id of wanted.slice(place.children.length)) {
      const figure = document.createElement("figure");
      figure.append(document.createElement("figcaption"), Object.assign(document.createElement("div"), { id }));
      place.append(figure);
    }
    for (const [i, from] of looks.entries()) {
      place.children[i].firstElementChild.textContent = looks.length > 1 ? from.one.title : "";
      await drawLobe(by(wanted[i]), from, looks.length > 1 ? 260 : 380);
    }
  }

  async function drawLobe(place, from, height) {
    const { one, direction } = from, logarithmic = by("logarithmic").checked;
    const grid = times(61, (i) => times(121, (k) => [(i * 90) / 60, (k * 360) / 120]));
    const of = times(one.hemispheres, (h) => readings(from, h));
    const top = most(of.flat().map((r) => r.mean)) || 1;
    const radius = (v) => (!(v > 0) ? 0 : !logarithmic ? v / top
                           : Math.max(0, 1 + Math.log10(v / top) / DECADES));
    const traces = of.map((known, h) => {
      const points = grid.map((row) => row.map(([theta, phi]) => {
        const r = radius(known[patchAt(one, theta, phi)]?.mean), [x, y, z] = towards(theta, phi);
        return [r * x, r * y, h ? -r * z : r * z, r];
      }));
      const [x, y, z, surfacecolor] = times(4, (i) => points.map((row) => row.map((point) => point[i])));
      return { type: "surface", x, y, z, surfacecolor,
               cmin: 0, cmax: 1, colorscale: "Viridis", showscale: false, hoverinfo: "skip" };
    });
    if (direction.theta_i !== null) {
      const [x, y, z] = towards(direction.theta_i, direction.phi_i).map((v) => [0, v]);
      traces.push({ type: "scatter3d", mode: "lines", hoverinfo: "skip", showlegend: false,
                    x, y, z, line: { color: "#d62728", width: 5 } });
    }
    const none = { showticklabels: false, title: { text: "" }, range: [-1, 1] }, both = one.hemispheres === 2;
    await Plotly.react(place, traces, {
      width: place.clientWidth, height, uirevision: "turned", showlegend: false,
      margin: { l: 0, r: 0, t: 0, b: 0 },
      scene: { camera: { eye: { x: 0.9, y: -1.3, z: 0.8 } }, xaxis: none, yaxis: none,
               zaxis: { ...none, range: [both ? -1 : 0, 1] },
               aspectmode: "manual", aspectratio: { x: 1, y: 1, z: both ? 1 : 0.5 } } }, { displaylogo: false });
  }

  // ------------------------------------------------------------------ numbers as text
  function tellNumbers({ one, direction }, more) {
    by("readings").replaceChildren();
    for (const cells of direction.rows) {
      const row = by("readings").insertRow();
      for (const cell of cells) row.insertCell().textContent = cell;
    }
    by("text").textContent = one.text;
    by("title").textContent = records.length > 1 ? one.title : one.name;
    by("notes").textContent = [...one.notes, ...more].join("\n");
  }

  function download(from) {
    const { theta_i, phi_i } = from.direction, link = document.createElement("a");
    const lines = FATES.slice(0, from.one.hemispheres).flatMap((fate, h) =>
      readings(from, h).map((r, patch) => [fate, patch, r.theta, r.phi, r.solid, r.mean,
                                           r.error, r.low, r.high, r.hits].join()));
    const header = "hemisphere,patch,theta_o,phi_o,solid_angle,value,std_err,low,high,rays";
    const csv = new Blob([[header, ...lines, ""].join("\n")], { type: "text/csv" });
    link.href = URL.createObjectURL(csv);
    link.download = `theta_i_${theta_i}_phi_i_${phi_i}.csv`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  // ------------------------------------------------------------------ controls
  function controls(one) {
    const { theta_i, phi_i } = one.directions[chosen(one)];
    const slide = (name, n, degrees) => {
      Object.assign(by(name), { max: n - 1, value: state[name], hidden: n < 2 });
      by(`${name}-value`).textContent = degrees === null ? "as the emitter" : `${degrees}\u00b0`;
    };
    slide("theta", one.rings.length, theta_i);
    slide("phi", one.rings[state.theta].length, phi_i);
    by("channel").replaceChildren(...one.channels.map((name, i) => new Option(name, i)));
    by("channel").value = state.channel;
    by("channel-label").hidden = one.channels.length < 2;
  }

  let current = null, busy = false, again = false;

  async function draw() {
    again = true;
    if (busy) return; // the newest state is drawn when this one is done
    for (busy = true; again; ) {
      again = false;
      const one = records[state.record], other = records[state.beside], more = [];
      controls(one);
      const looks = [current = await look(one, chosen(one))];
      if (other && other !== one) {
        const { theta_i, phi_i } = current.direction;
        const at = other.directions.findIndex((d) => d.theta_i === theta_i && d.phi_i === phi_i);
        if (at >= 0) looks.push(await look(other, at));
        else more.push(`${other.title} has no such incident direction.`);
        if (at >= 0 && !comparable(looks))
          more.push("No difference is drawn: these two have unlike collectors or channels.");
      }
      tellNumbers(current, more);
      await drawMaps(looks);
      await drawCut(looks);
      await drawLobes(looks);
    }
    busy = false;
    document.body.dataset.drawn = `${state.record}/${state.theta}/${state.phi}`;
  }

  // The cut begins in the plane of incidence, the colours where they show most.
  function begin() {
    const one = records[state.record], { phi_i } = one.directions[chosen(one)];
    state.azimuth = Math.round((((phi_i ?? 0) % 180) + 180) % 180) % 180;
  }

  records.forEach((one, i) => {
    one.title = records.length > 1 ? `${i + 1}: ${one.label}` : one.label;
    for (const name of ["record", "beside"]) by(name).append(new Option(one.title, i));
  });
  by("beside").value = state.beside;
  by("beside-label").hidden = by("record-label").hidden = records.length < 2;
  for (const name of Object.keys(state))
    by(name).addEventListener("input", () => {
      state[name] = Number(by(name).value);
      if (name === "record") {
        state.theta = state.phi = state.channel = 0;
        for (const key of Object.keys(pointed)) delete pointed[key];
      }
      if (name === "record" || name === "phi") begin();
      draw();
    });
  by("logarithmic").addEventListener("input", draw);
  by("csv").addEventListener("click", () => download(current));
  window.addEventListener("resize", draw);
  const { mean } = await look(records[0], 0), positive = mean.filter((v) => v > 0);
  by("logarithmic").checked = most(positive) > WIDE * positive.reduce((a, b) => Math.min(a, b), Infinity);
  begin();
  await draw();
})();
