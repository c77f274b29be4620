(function () {
  "use strict";
  const root = document.documentElement;
  const NARROW = 560, PAPER_WIDTH = 660;
  const figures = [];
  let printing = false;

  function colour(name) {
    return getComputedStyle(root).getPropertyValue("--" + name).trim();
  }

  function axis(width, kind) {
    const log = kind === "log";
    return {
      gridcolor: colour("grid"), linecolor: colour("rule"), zerolinecolor: colour("rule"),
      tickcolor: colour("rule"), ticks: "outside", ticklen: 4, showline: true, automargin: true,
      exponentformat: "power", showexponent: "all",
      // plotly writes powers a quarter larger than other numbers
      tickfont: { size: fontSize(width) * (log ? 0.88 : 1) },
      title: { standoff: 8, font: { size: 13 } },
    };
  }

  function fewer(axis, width) {
    if (width >= NARROW || axis.type === "category") return Object.assign({}, axis);
    return Object.assign({}, axis, { nticks: axis.type === "log" ? 5 : 6 });
  }

  function fontSize(width) { return width < NARROW ? 11 : 12.5; }

  function layout(spec, width) {
    const size = fontSize(width);
    // Its label stands above the figure in the page: read without a turned head, and it wraps
    const yaxis = fewer(spec.yaxis, width), xaxis = fewer(spec.xaxis, width);
    // Of a map both stand there
    if (yaxis.scaleanchor) delete xaxis.title;
    delete yaxis.title;
    // Room that ticks ask for changes the scale, the scale of a map its ticks, and so on
    const map = Boolean(yaxis.scaleanchor), flat = map && width < NARROW;
    const shown = function (kind) {
      return Object.assign(axis(width, kind), { automargin: !map });
    };
    return Object.assign({}, spec, {
      xaxis: xaxis,
      yaxis: yaxis,
      width: width, autosize: false, uirevision: "kept", hovermode: "closest",
      showlegend: false, bargap: 0.25,
      margin: { l: map ? 58 : 48, r: 18, t: flat ? 84 : 28, b: map ? 34 : 44 },
      dragmode: matchMedia("(pointer: coarse)").matches ? false : "zoom",
      template: { layout: {
        font: { family: getComputedStyle(document.body).fontFamily, size: size,
                color: colour("ink") },
        paper_bgcolor: colour("page"), plot_bgcolor: colour("page"),
        xaxis: shown(spec.xaxis.type), yaxis: shown(spec.yaxis.type),
        hoverlabel: { bgcolor: colour("panel"), bordercolor: colour("rule"),
                      font: { color: colour("ink"), size: 12.5 }, align: "left" },
        modebar: { bgcolor: colour("page"), color: colour("muted"),
                   activecolor: colour("accent") },
        shapedefaults: { line: { color: colour("muted") } },
        // Pale enough that a curve is seen through it
        annotationdefaults: { font: { color: colour("muted"), size: size - 1 },
                              bgcolor: colour("page") + "a0", borderpad: 1 },
      } },
    });
  }

  function paint(trace) {
    const shade = colour(trace.meta.halo ? "halo" : "curve-" + trace.meta.colour);
    // Of a line in colours its points have them; the line itself only closes gaps
    if (trace.line) trace.line.color = trace.marker ? colour("muted") : shade;
    else trace.marker = Object.assign({}, trace.marker, { color: shade });
    if (trace.error_y) trace.error_y.color = trace.type === "bar" ? colour("ink") : shade;
  }

  // The key of a line's colours: beside the plot, or above it where that is narrow
  function placeKey(trace, width) {
    const key = trace.marker && trace.marker.colorbar;
    if (!key) return;
    const above = width < NARROW;
    Object.assign(key, {
      orientation: above ? "h" : "v", x: above ? 0.5 : 1.01, xanchor: above ? "center" : "left",
      y: above ? 1.03 : 0.5, yanchor: above ? "bottom" : "middle", lenmode: "fraction",
      tickfont: { size: fontSize(width) - 1, color: colour("ink") }, nticks: 6,
    });
    key.title = Object.assign({}, key.title, { side: above ? "top" : "right",
      font: { size: fontSize(width), color: colour("ink") } });
  }

  // The length of 1, 2 or 5 with any power of ten that is a fifth of the map, or less
  function showScale(figure) {
    const plot = figure.plot, axis = plot._fullLayout.xaxis;
    if (!plot._fullLayout.yaxis.scaleanchor) return;
    if (!figure.scale) {
      figure.scale = document.createElement("div");
      figure.scale.className = "scale";
      plot.append(figure.scale);
      plot.on("plotly_relayout", function () { showScale(figure); });
    }
    const span = Math.abs(axis.range[1] - axis.range[0]) / 5;
    const power = Math.pow(10, Math.floor(Math.log10(span)));
    const size = (span >= 5 * power ? 5 : span >= 2 * power ? 2 : 1) * power;
    const unit = figure.spec.layout.xaxis.title.text.split(", ").pop();
    const metres = unit === "km" && size < 1;
    figure.scale.textContent = Number((metres ? 1000 * size : size).toPrecision(1)) + " " +
      (metres ? "m" : unit);
    figure.scale.style.width = size / (5 * span) * axis._length + "px";
    figure.scale.style.left = axis._offset + 12 + "px";
    figure.scale.style.bottom = plot._fullLayout._size.b + 10 + "px";
  }

  const saving = {
    name: "save", title: "Save as PNG",
    click: function (plot) {
      const size = { width: 1100, height: 620 };
      const figure = figures.find(function (one) { return one.plot === plot; });
      const look = Object.assign(layout(figure.spec.layout, size.width), {
        showlegend: true, legend: { orientation: "h", y: -0.16, yanchor: "top" },
      });
      look.xaxis = Object.assign({}, look.xaxis, seen(plot.layout.xaxis));
      look.yaxis = Object.assign({}, look.yaxis, seen(plot.layout.yaxis));
      look.margin.t = 64;
      look.xaxis.title = figure.spec.layout.xaxis.title;
      look.margin.b = 50;
      look.annotations = look.annotations.concat({
        text: "<b>" + figure.title + "</b><br>" + figure.spec.layout.yaxis.title.text,
        xref: "paper", x: 0, xanchor: "left", yref: "paper", y: 1, yanchor: "bottom", yshift: 8,
        showarrow: false, align: "left", font: { size: 14, color: colour("ink") },
      });
      const data = figure.spec.data.filter(function (trace) { return trace.visible; });
      Plotly.downloadImage({ data: data, layout: look },
        Object.assign({ format: "png", scale: 2, filename: figure.key }, size));
    },
  };

  function seen(axis) { return { range: axis.range.slice(), autorange: false }; }

  const config = {
    displaylogo: false, responsive: false, doubleClick: "reset+autosize",
    // All that there are, as plotly's own choice changes, and has held ways to send data away
    modeBarButtons: [["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"], [saving]],
  };

  function draw(figure) {
    const width = printing ? PAPER_WIDTH : figure.plot.clientWidth;
    if (!width) return Promise.resolve();
    figure.spec.data.forEach(paint);
    const look = layout(figure.spec.layout, width);
    look.height = figure.plot.clientHeight;
    figure.spec.data.forEach(function (trace) { placeKey(trace, width); });
    return Plotly.react(figure.plot, figure.spec.data, look, config)
      .then(function () { showScale(figure); });
  }

  function drawAll() { return figures.reduce(
    function (before, figure) { return before.then(function () { return draw(figure); }); },
    Promise.resolve()); }

  function showLegend(figure) {
    figure.buttons.forEach(function (button, k) {
      button.setAttribute("aria-pressed", String(figure.spec.data[k].visible));
    });
  }

  function answer(figure) {
    figure.buttons.forEach(function (button, k) {
      const data = figure.spec.data;
      button.disabled = false;
      button.addEventListener("click", function (event) {
        if (event.shiftKey || event.altKey) {
          const alone = data.every(function (one, j) { return one.visible === (j === k); });
          data.forEach(function (one, j) { one.visible = alone || j === k; });
        } else data[k].visible = !data[k].visible;
        showLegend(figure);
        draw(figure);
      });
    });
  }

  function unpacked(name) {
    const text = atob(document.getElementById(name).textContent);
    const bytes = Uint8Array.from(text, function (sign) { return sign.charCodeAt(0); });
    const flow = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(flow).arrayBuffer();
  }

  function numbersOf(place, block) {
    const size = place.type === "f8" ? 8 : 4, n = place.n;
    const bytes = new Uint8Array(n * size);
    for (let k = 0; k < size; k++)
      for (let i = 0; i < n; i++) bytes[i * size + k] = block[place.at + k * n + i];
    if (place.steps) {
      const bits = new Uint32Array(bytes.buffer);
      for (let i = 1; i < n; i++) bits[i] += bits[i - 1];
    }
    return size === 8 ? new Float64Array(bytes.buffer) : new Float32Array(bytes.buffer);
  }

  // Arrays stand in the figures as places in the block of numbers
  function filled(value, block) {
    if (value === null || typeof value !== "object") return value;
    if ("at" in value && "n" in value) return numbersOf(value, block);
    for (const key of Object.keys(value)) value[key] = filled(value[key], block);
    return value;
  }

  async function start() {
    if (document.getElementById("library")) {
      const library = document.createElement("script");
      library.textContent = new TextDecoder().decode(await unpacked("library"));
      document.head.append(library);
    }
    saving.icon = Plotly.Icons.camera;
    const block = new Uint8Array(await unpacked("numbers"));
    document.querySelectorAll(".drawing").forEach(function (plot) {
      const holder = plot.closest("figure");
      const spec = JSON.parse(holder.querySelector("script").textContent);
      filled(spec.data, block);
      const figure = {
        plot: plot, key: plot.dataset.key, title: plot.dataset.title, spec: spec,
        buttons: holder.querySelectorAll(".legend button"),
      };
      figures.push(figure);
      answer(figure);
    });
    await drawAll();
    root.dataset.figures = "drawn";
  }

  let waiting = 0, width = window.innerWidth;
  addEventListener("resize", function () {
    // A telephone's address bar changes the height alone
    if (window.innerWidth === width) return;
    width = window.innerWidth;
    clearTimeout(waiting);
    waiting = setTimeout(drawAll, 120);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);

  function print(now) {
    printing = now;
    root.classList.toggle("printing", now);
    // Paper has nothing to click on: settings at their defaults are printed too
    document.querySelectorAll("details.kept").forEach(function (one) {
      if (now) { one.dataset.was = one.open; one.open = true; }
      else one.open = one.dataset.was === "true";
    });
    // Not one after the other: the browser takes the page as it is when this returns
    figures.forEach(draw);
  }
  addEventListener("beforeprint", function () { print(true); });
  addEventListener("afterprint", function () { print(false); });

  start();
})();
