// Draws the panels of the timeline and reacts to clicks. Runs once Bokeh has drawn the page.
//
// All panels are one picture, twice as wide as the screen shows, so that it only moves while the
// timeline is panned; it is drawn anew where it ends, and after a zoom. A column of pixels is the
// frame in it, or all that lie in it.
const names = JSON.parse(document.getElementById("names").textContent)
const timeline = document.getElementById("timeline")
const cursor = document.getElementById("cursor")
const tip = document.getElementById("tip")
const [earliest, latest] = [time.start, time.end]

const rgba = (hex, alpha = 255) => {
  const n = parseInt(hex.slice(1), 16)
  return ((alpha << 24) | ((n & 255) << 16) | (n & 0xff00) | (n >> 16)) >>> 0
}
const colour = (r, g, b) => ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0
const certain = look.ramp.length / 3 - 1
const ramp = Uint32Array.from({length: certain + 1}, (_, p) =>
  colour(look.ramp[3 * p], look.ramp[3 * p + 1], look.ramp[3 * p + 2]))
const between = (hex, share) => {
  const n = parseInt(hex.slice(1), 16)
  const mix = (c) => Math.round(255 + share * (c - 255))
  return colour(mix(n >> 16), mix((n >> 8) & 255), mix(n & 255))
}

for (const track of tracks) {
  track.of = (name) => track.columns.get_column(name)
  track.all = (letter, n) => Array.from({length: n}, (_, k) => track.of(`${letter}${k + 1}`))
  track.t = track.of("t")
}

// The first index whose time is not before x.
function after(t, x) {
  let [low, high] = [0, t.length]
  while (low < high) {
    const middle = (low + high) >> 1
    if (t[middle] < x) low = middle + 1
    else high = middle
  }
  return low
}

function nearest(track, x) {
  const i = after(track.t, x)
  return i == track.t.length || (i > 0 && x - track.t[i - 1] < track.t[i] - x) ? i - 1 : i
}

// The frames in each of n columns: from first[c] to before last[c]. A frame lasts for its step.
function columns_of(track, begin, dx, n) {
  const {t, step} = track
  const [first, last] = [new Int32Array(n), new Int32Array(n)]
  let i = after(t, begin)
  for (let c = 0; c < n; c++) {
    let j = i
    const end = begin + (c + 1) * dx
    while (j < t.length && t[j] < end) j++
    if (j == i) {
      const middle = end - dx / 2
      const k = i == t.length || (i > 0 && middle - t[i - 1] < t[i] - middle) ? i - 1 : i
      if (Math.abs(t[k] - middle) <= 0.6 * step) [first[c], last[c]] = [k, k + 1]
    } else {
      [first[c], last[c]] = [i, j]
    }
    i = j
  }
  return {first, last, n}
}

// The picture: rows from above, n columns. Bokeh has its rows from below.
let [pixels, n] = [null, 0]
const height = panels.reduce((low, panel) => Math.max(low, panel.top + panel.height), 0)
const [white, faint, hatch] = [rgba("#ffffff"), rgba(look.faint), rgba("#cccccc")]
const row = (y) => (height - 1 - y) * n

// Fills rows from y to before stop with a line of colours; where that is 0 it is hatched.
function band(line, y, stop) {
  const is_whole = line.indexOf(0) < 0
  for (; y < stop; y++) {
    const at = row(y)
    pixels.set(line, at)
    if (is_whole) continue
    for (let c = 0; c < n; c++) if (!line[c]) pixels[at + c] = (c + y) % 7 ? white : hatch
  }
}

function box(y, c, wide, high, paint) {
  for (let r = y; r < y + high; r++) {
    pixels.fill(paint, row(r) + Math.max(c, 0), row(r) + Math.min(Math.max(c + wide, 0), n))
  }
}

// A dot or a cross of 9 pixels around a column.
function mark(y, c, paint, is_cross) {
  for (let a = -4; a <= 4; a++) {
    for (let b = -4; b <= 4; b++) {
      const is_in = is_cross ? Math.abs(Math.abs(a) - Math.abs(b)) < 1.5 : a * a + b * b < 18
      if (is_in && c + b >= 0 && c + b < n) pixels[row(y + a) + c + b] = paint
    }
  }
}

const draw = {
  belief(panel, track, {first, last}) {
    const line = new Uint32Array(n)
    track.all(panel.letter, panel.lanes).forEach((values, k) => {
      for (let c = 0; c < n; c++) {
        let [sum, count] = [0, 0]
        for (let i = first[c]; i < last[c]; i++) {
          if (values[i] != look.blank) {
            sum += values[i]
            count++
          }
        }
        line[c] = count ? ramp[Math.round(sum / count)] : 0
      }
      band(line, panel.top + k * look.lane, panel.top + (k + 1) * look.lane)
      box(panel.top + k * look.lane, 0, n, 1, faint)
    })
  },

  truth(panel, track, {first, last}) {
    const [truth, crossing] = [track.of("truth"), track.of("crossing")]
    const count = new Int32Array(panel.lanes + 1)
    const lines = Array.from({length: panel.lanes}, () => new Uint32Array(n))
    for (let c = 0; c < n; c++) {
      let [known, changes] = [0, 0]
      count.fill(0)
      for (let i = first[c]; i < last[c]; i++) {
        if (crossing[i]) changes++
        else if (truth[i]) {
          known++
          count[truth[i]]++
        }
      }
      if (!known && !changes) continue
      for (let k = 0; k < panel.lanes; k++) {
        lines[k][c] = changes ? rgba(look.crossing)
          : ramp[Math.round(0.8 * certain * count[k + 1] / known)]
      }
    }
    lines.forEach((line, k) => {
      band(line, panel.top + k * look.lane, panel.top + (k + 1) * look.lane)
      box(panel.top + k * look.lane, 0, n, 1, faint)
    })
  },

  answers(panel, track, {first, last}) {
    const [truth, crossing] = [track.of("truth"), track.of("crossing")]
    const line = new Uint32Array(n)
    panel.names.forEach((name, r) => {
      const lane = track.of(name)
      for (let c = 0; c < n; c++) {
        let [known, wrong, none] = [0, 0, 0]
        for (let i = first[c]; i < last[c]; i++) {
          if (!truth[i] || crossing[i]) continue
          known++
          if (!lane[i]) none++
          else if (lane[i] != truth[i]) wrong++
        }
        // A single wrong frame among many is still seen.
        const share = known && (wrong + none) ? 0.25 + 0.75 * (wrong + none) / known : 0
        line[c] = known ? between(none > wrong ? look.none : look.wrong, share) : 0
      }
      band(line, panel.top + r * look.answer, panel.top + (r + 1) * look.answer)
      box(panel.top + r * look.answer, 0, n, 1, faint)
    })
  },

  events(panel, track, found, begin, dx) {
    const column = (t) => Math.round((t - begin) / dx)
    for (const [from, to, paint] of panel.true) {
      const c = column(from)
      if (c < n) box(panel.top + 20, c, Math.max(column(to) - c, 3), 11, rgba(paint))
    }
    for (const [t, paint, is_cross] of panel.told) {
      const c = column(t)
      if (c > -5 && c < n + 5) mark(panel.top + 9, c, rgba(paint), is_cross)
    }
    box(panel.top, 0, n, 1, faint)
  },

  curves(panel, track, {first, last}) {
    const [high, spread] = [panel.height, 0.05]
    const place = (p) => panel.top + Math.round((1 + spread - p / certain) / (1 + 2 * spread) * (high - 2))
    box(panel.top, 0, n, 1, faint)
    track.all("c", panel.colours.length).forEach((values, k) => {
      const [strong, pale] = [rgba(panel.colours[k]), between(panel.colours[k], 0.3)]
      let before = -1
      for (let c = 0; c < n; c++) {
        if (first[c] == last[c]) {
          before = -1
          continue
        }
        let [least, most, sum] = [255, 0, 0]
        for (let i = first[c]; i < last[c]; i++) {
          least = Math.min(least, values[i])
          most = Math.max(most, values[i])
          sum += values[i]
        }
        const mean = place(sum / (last[c] - first[c]))
        for (let y = place(most); y <= place(least); y++) {
          if (pixels[row(y) + c] == white) pixels[row(y) + c] = pale
        }
        const [a, b] = before < 0 ? [mean, mean] : [Math.min(mean, before), Math.max(mean, before)]
        for (let y = a; y <= b + 1; y++) pixels[row(y) + c] = strong
        before = mean
      }
    })
  },

  lines(panel, track, {first, last}) {
    const [cm, kind] = [track.lines.get_column("cm"), track.lines.get_column("kind")]
    const [starts, high] = [track.of("first"), panel.height]
    const shown = look.lines.map((hex) => rgba(hex))
    const what = new Uint8Array(high * n)
    for (let c = 0; c < n; c++) {
      if (first[c] == last[c]) continue
      const stop = last[c] < starts.length ? starts[last[c]] : cm.length
      for (let j = starts[first[c]]; j < stop; j++) {
        const y = Math.floor((0.5 + cm[j] / 200 / panel.most) * high)
        for (let at = y - 1; at <= y; at++) {
          if (at >= 0 && at < high && what[at * n + c] < kind[j]) what[at * n + c] = kind[j]
        }
      }
    }
    for (const y of [0, high >> 1, high - 1]) box(panel.top + y, 0, n, 1, faint)
    for (let y = 0; y < high; y++) {
      const at = row(panel.top + y)
      for (let c = 0; c < n; c++) {
        if (what[y * n + c]) pixels[at + c] = shown[what[y * n + c] - 1]
      }
    }
  },
}

// --- what is drawn -------------------------------------------------------------------------------

const width_of = () => Math.max(plot.inner_width ?? 0, 100)
const left_of = () => (plot.outer_width ?? 0) - width_of() - look.right
const NDArray = image.get_column("image")[0].constructor
let drawn = {begin: 0, end: -1, dx: 0}

function refresh() {
  const span = time.end - time.start
  const dx = span / width_of()
  if (!(dx > 0)) return
  const is_there = Math.abs(dx / drawn.dx - 1) < 1e-6
    && time.start >= drawn.begin && time.end <= drawn.end
  if (!is_there) {
    // Columns begin at multiples of their width, so that what is in each does not change.
    const begin = Math.floor((time.start - span / 2) / dx) * dx
    n = 2 * width_of() + 2
    drawn = {begin, end: begin + n * dx, dx}
    pixels = new NDArray(height * n, [height, n]).fill(white)
    const found = tracks.map((track) => columns_of(track, begin, dx, n))
    for (const panel of panels) {
      draw[panel.kind](panel, tracks[panel.track], found[panel.track], begin, dx)
    }
    image.data = {image: [pixels], x: [begin], dw: [n * dx]}
  }
  document.getElementById("panels").style.top = `${plot.outer_height - plot.inner_height}px`
  films()
}

// Pictures stand at their times; every second, fourth, ... of them where they would overlap.
function films() {
  for (const film of document.querySelectorAll(".film")) {
    const images = [...film.children]
    const [width, left, scale] = [width_of(), left_of(), width_of() / (time.end - time.start)]
    const wide = film.clientHeight * (images[0].naturalWidth / images[0].naturalHeight || 2)
    const times = images.map((image) => Number(image.dataset.t))
    const apart = (times[times.length - 1] - times[0]) / Math.max(times.length - 1, 1) * scale
    let every = 1
    while (every < images.length && every * apart < wide + 2) every *= 2
    images.forEach((image, k) => {
      const x = (times[k] - time.start) * scale - wide / 2
      const is_seen = k % every == 0 && x >= 0 && x + wide <= width
      image.style.display = is_seen ? "block" : "none"
      image.style.transform = `translateX(${left + x}px)`
    })
  }
}

time.on_change([time.properties.start, time.properties.end], refresh)
plot.on_change(plot.properties.inner_width, refresh)

// --- moving --------------------------------------------------------------------------------------

function go(start, end) {
  const span = Math.min(Math.max(end - start, time.min_interval), latest - earliest)
  const middle = (start + end) / 2
  const begin = Math.min(Math.max(middle - span / 2, earliest), latest - span)
  time.setv({start: begin, end: begin + span})
}

const zoomed = (by) => () => {
  const [middle, half] = [(time.start + time.end) / 2, (time.end - time.start) / 2 * by]
  go(middle - half, middle + half)
}
const moved = (by) => () => {
  const far = (time.end - time.start) * by
  go(time.start + far, time.end + far)
}
const moves = {
  whole: () => go(earliest, latest), closer: zoomed(0.5), farther: zoomed(2),
  back: moved(-0.5), on: moved(0.5),
  box: (button) => {
    const is_box = !tools.box.active
    tools.pan.active = !is_box
    tools.box.active = is_box
    button.setAttribute("aria-pressed", String(is_box))
  },
}
for (const button of document.querySelectorAll("[data-move]")) {
  button.addEventListener("click", () => moves[button.dataset.move](button))
}
for (const button of document.querySelectorAll("[data-begin]")) {
  button.addEventListener("click", () => {
    const [begin, end] = [Number(button.dataset.begin), Number(button.dataset.end)]
    const beside = Math.max(end - begin, 4)
    go(begin - beside, end + beside)
    timeline.scrollIntoView({block: "nearest"})
  })
}

// --- what is under the mouse ---------------------------------------------------------------------

const percent = (byte) => byte == look.blank ? "-" : (byte / certain).toFixed(2)
const lane = (k) => k ? `lane ${k}` : "no answer"

function said(track, name, i) {
  const [rows, at] = [[], (column) => track.of(column)[i]]
  const many = track.each > 1 ? ` (and ${track.each - 1} beside it)` : ""
  rows.push([name.title, `frame ${at("id")}${many}`])
  const beliefs = track.all("b", track.n).map((values) => percent(values[i])).join("  ")
  rows.push(["model", `${lane(at("model"))}:  ${beliefs}`])
  if (track.of("detector")) rows.push(["detector", lane(at("detector"))])
  if (at("crossing")) rows.push(["truth", "changing lanes"])
  else if (at("truth")) rows.push(["truth", lane(at("truth"))])
  for (let c = 0; c < track.curves; c++) rows.push([name.curves[c], percent(at(`c${c + 1}`))])
  const starts = track.of("first")
  if (starts) {
    const [cm, kind] = [track.lines.get_column("cm"), track.lines.get_column("kind")]
    const valid = []
    for (let j = starts[i]; j < (starts[i + 1] ?? cm.length); j++) {
      if (kind[j] > 1) valid.push((cm[j] / 100).toFixed(1))
    }
    rows.push(["valid lines, m", valid.sort((a, b) => a - b).join("  ") || "none"])
  }
  return rows
}

function show(x, place) {
  tip.replaceChildren()
  const head = document.createElement("b")
  head.textContent = `${x.toFixed(2)} s`
  tip.append(head)
  const table = document.createElement("table")
  tracks.forEach((track, k) => {
    const i = nearest(track, x)
    if (Math.abs(track.t[i] - x) > 1.5 * track.step) return
    for (const [what, value] of said(track, names[k], i)) {
      const row = table.insertRow()
      row.insertCell().textContent = what
      row.insertCell().textContent = value
    }
  })
  tip.append(table)
  const pictures = [...document.querySelectorAll(".film img")]
  if (pictures.length) {
    const far = (image) => Math.abs(Number(image.dataset.t) - x)
    const best = pictures.reduce((a, b) => far(b) < far(a) ? b : a)
    const picture = document.createElement("img")
    picture.src = best.src
    const note = document.createElement("div")
    note.textContent = `the picture of ${Number(best.dataset.t).toFixed(1)} s`
    tip.append(picture, note)
  }
  tip.hidden = cursor.hidden = false
  const box = timeline.getBoundingClientRect()
  cursor.style.left = `${place.x - box.left}px`
  const left = place.x + 16 + tip.offsetWidth < innerWidth ? place.x + 16 : place.x - 16 - tip.offsetWidth
  tip.style.left = `${Math.max(left, 4)}px`
  tip.style.top = `${Math.max(Math.min(place.y + 16, innerHeight - tip.offsetHeight - 4), 4)}px`
}

function hide() {
  tip.hidden = cursor.hidden = true
}

function under(event) {
  const box = timeline.getBoundingClientRect()
  const share = (event.clientX - box.left - left_of()) / width_of()
  if (share < 0 || share > 1 || event.buttons) return hide()
  show(time.start + share * (time.end - time.start), {x: event.clientX, y: event.clientY})
}
timeline.addEventListener("pointermove", (event) => event.pointerType == "mouse" && under(event))
timeline.addEventListener("pointerleave", hide)
timeline.addEventListener("click", under)

// On a telephone an upward stroke scrolls the page, a sideward one the timeline.
function strokes(element) {
  for (const each of element.querySelectorAll("*")) {
    if (each.classList.contains("bk-events")) each.style.touchAction = "pan-y"
    if (each.shadowRoot) strokes(each.shadowRoot)
  }
}
strokes(timeline)

refresh()
document.body.dataset.ready = "yes"
