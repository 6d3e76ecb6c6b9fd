// A stand-in for the server, to work on the page alone: node mock.mjs [port] [scene.json ...]
// A scene file holds {"scene": ..., "clips": [...]}, as the API gives them; without one a made-up body is drawn.

import { createServer } from "node:http";
import { readFileSync } from "node:fs";
import nunjucks from "nunjucks";

const here = new URL(".", import.meta.url).pathname;
const web = `${here}../src/hiprl/web/`;
const [port = "8123", ...files] = process.argv.slice(2);
const csp = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; form-action 'self'";
const pages = new nunjucks.Environment(new nunjucks.FileSystemLoader(`${web}templates`), { autoescape: true });
const types = { js: "text/javascript", css: "text/css", svg: "image/svg+xml", txt: "text/plain" };

const base64 = (numbers) => Buffer.from(new Float32Array(numbers).buffer).toString("base64");

function hopper(n, count) {
  const poses = [];
  for (let f = 0; f < count; f++) {
    const x = f * 0.02 * (n + 1), z = 0.6 + 0.2 * Math.abs(Math.sin(f * 0.2));
    poses.push(0, 0, 0, 1, 0, 0, 0, x, 0, z, 1, 0, 0, 0, x, 0, z - 0.35, Math.cos(f / 20), 0, Math.sin(f / 20), 0);
  }
  return { trajectory: n, start: 0, steps: count, poses: base64(poses) };
}

const madeUp = {
  scene: {
    kind: "mujoco", dt: 0.04, bodies: 3,
    meshes: [{
      vertices: base64([0.2, 0, 0, -0.1, 0.15, 0, -0.1, -0.15, 0, 0, 0, 0.3]),
      faces: Buffer.from(new Uint32Array([0, 1, 3, 1, 2, 3, 2, 0, 3, 0, 2, 1]).buffer).toString("base64"),
    }],
    geoms: [
      { body: 0, type: "plane", size: [40, 40, 1], pos: [0, 0, 0], quat: [1, 0, 0, 0], rgba: [0.5, 0.5, 0.5, 1] },
      { body: 1, type: "box", size: [0.25, 0.12, 0.1], pos: [0, 0, 0], quat: [1, 0, 0, 0], rgba: [0.8, 0.6, 0.4, 1] },
      { body: 1, type: "mesh", mesh: 0, size: [0.2, 0.2, 0.2], pos: [0, 0, 0.1], quat: [1, 0, 0, 0], rgba: [0.85, 0.45, 0.4, 1] },
      { body: 2, type: "capsule", size: [0.05, 0.22, 0], pos: [0, 0, 0], quat: [1, 0, 0, 0], rgba: [0.4, 0.6, 0.8, 1] },
    ],
  },
  clips: [hopper(0, 60), hopper(1, 60), hopper(2, 35), hopper(1, 60)],
};

const states = {
  scene: { kind: "states", dt: 0.05, names: ["angle", "speed", "torque"] },
  clips: [0, 1, 2, 3].map((n) => ({
    trajectory: n, start: 0, steps: n % 2 ? 60 : 40,
    states: base64(Array.from({ length: 3 * (n % 2 ? 60 : 40) }, (_, i) => Math.sin((i * (n + 1)) / 30 + (i % 3)))),
  })),
};

const picture = (n, f) => `data:image/svg+xml,${encodeURIComponent(`<svg xmlns="http://www.w3.org/2000/svg" width="300" height="200"><rect width="300" height="200" fill="#fff"/><rect x="${100 + 80 * Math.sin(f / 9 + n)}" y="140" width="60" height="30" fill="#357"/><line x1="${130 + 80 * Math.sin(f / 9 + n)}" y1="140" x2="${130 + 90 * Math.sin(f / 9 + n)}" y2="40" stroke="#b63" stroke-width="8"/></svg>`)}`;
const frames = {
  scene: { kind: "frames", dt: 0.05 },
  clips: [0, 1, 2, 3].map((n) => ({ trajectory: n, start: 0, steps: 40, frames: Array.from({ length: 40 }, (_, f) => picture(n, f)) })),
};

const runs = new Map();
const add = (name, env, { scene, clips }, more = {}) => runs.set(name, {
  name, env, scene, clips, goal: null, planned: 30, answers: [], delay: 300, ...more,
});
files.forEach((file, i) => {
  const text = JSON.parse(readFileSync(file, "utf8"));
  add(`run-${i}`, file.split(/[/_.]/).at(-2), text, { goal: "walk forward without hopping" });
});
add("made-up", "Box-v0", madeUp);
add("frames", "CartPole-v1", frames, { goal: "stay in the middle" });
add("states", "Pendulum-v1", states, { goal: "swing up and stay there" });
add("busy", "Box-v0", madeUp, { goal: "wait for it", delay: 1e9 });
add("finished", "Box-v0", madeUp, { goal: "be done", planned: 0, done: true });
const past = [{ form: "choice", value: 1 }, { form: "level", value: -2, levels: 5 }, { form: "equal" }, { form: "unsure" }, { form: "level", value: 1, levels: 5 }];
for (const run of runs.values()) {
  run.ready = 0;
  past.forEach((answer, k) => run.answers.push({ k: k + 1, judge: "me", answer, swapped: false, at: `2025-01-0${k + 1}`, agrees: [true, false, null, null, true][k] }));
}

const question = (run, k, answer = null) => ({
  k, swapped: false, answer, clips: [0, 1].map((i) => run.clips[(k + i) % run.clips.length]),
});
const state = (run) => (run.done ? "finished" : Date.now() < run.ready || run.delay > 1e6 ? "learning" : "waiting");
const progress = (run) => {
  const n = run.answers.length;
  return { answers: n, planned: run.planned, open: 1, episodes: n + 5, sure: n > 3 ? 0.8 : null, worth: 0.3 / (n + 1), enough: false, state: state(run), people: true, trained: true, goal: run.goal };
};
const facts = (run) => ({
  run: run.name, env: run.env, goal: run.goal, finished: Boolean(run.done), planned: run.planned, pictures: [],
  episodes: Array.from({ length: 26 }, (_, k) => ({
    k: k + 1, comparisons: k, true_return: 40 * k + 200 * Math.sin(k), return_by_reward: Math.sqrt(k) + 0.3 * Math.sin(2 * k),
    worth: 0.5 / (k + 1), foreseen: k > 2 ? (k * 7) % 10 < 4 + k / 4 : null,
  })),
  weights: { "forward speed": 0.46, "height of the body": 0.22, "turning of the front leg": -0.14, effort: -0.1, "pitch": 0.05, "squared speed": 0.03 },
});

function reply(res, status, body, type = "application/json") {
  res.writeHead(status, { "Content-Type": `${type}; charset=utf-8`, "Content-Security-Policy": csp, "Cache-Control": "no-store" });
  res.end(type === "application/json" ? JSON.stringify(body) : body);
}

const page = (res, name, values, status = 200) => reply(res, status, pages.render(`${name}.html`, values), "text/html");
const body = (req) => new Promise((done) => {
  let text = "";
  req.on("data", (part) => (text += part));
  req.on("end", () => done(JSON.parse(text || "{}")));
});

createServer(async (req, res) => {
  const url = new URL(req.url, "http://x");
  const path = url.pathname.split("/").filter(Boolean).map(decodeURIComponent);
  if (path[0] === "static" && path.length === 2) {
    try {
      return reply(res, 200, readFileSync(`${web}static/${path[1]}`), types[path[1].split(".").at(-1)]);
    } catch {
      return reply(res, 404, "no", "text/plain");
    }
  }
  if (!path.length) {
    return page(res, "runs", { runs: [...runs.values()].map((r) => ({ run: r.name, env: r.env, goal: r.goal, answers: r.answers.length, planned: r.planned, open: r.done ? 0 : 1, finished: r.done })) });
  }
  if (path[0] === "none") return page(res, "runs", { runs: [] });
  if (path[0] === "enter") return page(res, "enter", { error: req.method === "POST" ? "That is not the token." : null });
  const run = runs.get(path[0] === "api" ? path[2] : path[1]);
  if (!run) return path[0] === "api" ? reply(res, 404, { error: "No such run." }) : page(res, "error", { status: 404, title: "Not here", text: "There is no page at this address." }, 404);
  if (path[0] === "runs") {
    const name = { undefined: "run", teach: "teach", review: "review" }[path[2]];
    return page(res, name, { run: run.name, env: run.env, goal: run.goal });
  }
  const what = path[3];
  if (req.method === "POST") {
    if (req.headers["x-hiprl"] !== "1") return reply(res, 403, { error: "This came from another page." });
    const got = await body(req);
    console.log(what, JSON.stringify(got));
    if (what === "goal") run.goal = got.goal;
    else if (what === "enough") run.done = true;
    else {
      run.answers = run.answers.filter((a) => a.k !== got.k);
      run.answers.push({ ...got, at: new Date().toISOString(), agrees: null });
      run.ready = Date.now() + run.delay;
    }
    return reply(res, 200, { new: true, progress: progress(run) });
  }
  switch (what) {
    case "scene": return reply(res, 200, run.scene);
    case "next": return reply(res, 200, {
      question: state(run) === "waiting" ? question(run, Math.max(0, ...run.answers.map((a) => a.k)) + 1) : null, progress: progress(run),
    });
    case "last": {
      const last = run.answers.at(-1);
      return reply(res, 200, { question: last ? question(run, last.k, last.answer) : null });
    }
    case "now": return reply(res, 200, { clip: run.clips[1], episode: run.answers.length + 5 });
    case "answers": return reply(res, 200, run.answers.map((a) => ({ ...a, sided: ["choice", "level"].includes(a.answer.form), clips: question(run, a.k).clips.map(({ trajectory, start, steps }) => ({ trajectory, start, steps })) })));
    case "questions": return reply(res, 200, { question: question(run, Number(path[4])) });
    case "facts": return reply(res, 200, facts(run));
    case "events": {
      res.writeHead(200, { "Content-Type": "text/event-stream", "Content-Security-Policy": csp });
      const send = () => res.write(`event: progress\ndata: ${JSON.stringify(progress(run))}\n\n`);
      send();
      const clock = setInterval(send, 2000);
      return req.on("close", () => clearInterval(clock));
    }
    default: return reply(res, 404, { error: "No such thing." });
  }
}).listen(Number(port), "127.0.0.1", () => console.log(`http://127.0.0.1:${port}/`));
