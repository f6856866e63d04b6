// While a run is trained: the newest model every few seconds, and its numbers as they come.

import { readModel } from "./model.js";
import { writeList } from "./panel.js";
import { $ } from "./state.js";

const PAUSE_MS = 500;
const LOST_PAUSE_MS = 3000; // between attempts, while the server does not answer

// Resolves when the first model is there. The server is asked for a model only while the page is seen.
export async function followTraining(pane, stage) {
    const curve = [];
    $("training").hidden = false;
    const events = new EventSource("events");
    events.addEventListener("progress", ({ data }) => {
        const progress = JSON.parse(data);
        curve.push(progress.psnr);
        showProgress(progress, curve);
    });
    const run = { ended: false };
    events.addEventListener("end", () => {
        run.ended = true;
        events.close(); // after an error it connects again by itself
    });
    while (!pane.model) await fetchModel(pane, stage);
    keepFetching(pane, stage, run);
}

async function keepFetching(pane, stage, run) {
    const section = $("training").classList;
    for (let last = false, pause = PAUSE_MS; !last; ) {
        last = run.ended;
        await new Promise((resolve) => setTimeout(resolve, pause));
        if (document.hidden && !last) continue;
        try {
            await fetchModel(pane, stage);
            section.remove("lost");
            pause = PAUSE_MS;
        } catch {
            if (!last) section.add("lost"); // a sleeping computer, or the run was stopped: the last model stays
            pause = LOST_PAUSE_MS;
        }
    }
    section.remove("lost");
    section.add("ended");
}

// The server answers when there is a newer model than the one that is shown, or after a while that there is none.
async function fetchModel(pane, stage) {
    const response = await fetch(`model?after=${pane.model?.header.iteration ?? -1}`, { cache: "no-store" });
    if (response.status === 204) return;
    if (!response.ok) throw new Error(await response.text());
    const bytes = new Uint8Array(await response.arrayBuffer());
    const length = new DataView(bytes.buffer).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    const model = await readModel(header, bytes.subarray(4 + length), stage.scene);
    while (stage.drawing) await stage.drawing;
    pane.setModel(model);
    stage.invalidate();
}

function showProgress(progress, curve) {
    writeList($("training").querySelector("dl"), [
        ["iteration", `${progress.iteration} of ${progress.iterations}`],
        ["loss", progress.loss.toFixed(4)],
        ["PSNR of the batch", `${progress.psnr.toFixed(2)} dB`],
        ["held-out PSNR", progress.held_out === null ? "–" : `${progress.held_out.toFixed(2)} dB`],
        ["Gaussians", String(progress.n_gaussians)],
    ]);
    drawCurve($("training").querySelector("canvas"), curve);
}

function drawCurve(canvas, values) {
    const pen = canvas.getContext("2d");
    const { width, height } = canvas;
    pen.clearRect(0, 0, width, height);
    if (values.length < 2) return;
    const [low, high] = [Math.min(...values), Math.max(...values)];
    pen.strokeStyle = "#7cc4ff";
    pen.lineWidth = 1.5;
    pen.beginPath();
    values.forEach((value, i) => {
        const at = [(i / (values.length - 1)) * width, height - 4 - ((value - low) / (high - low || 1)) * (height - 8)];
        if (i === 0) pen.moveTo(...at);
        else pen.lineTo(...at);
    });
    pen.stroke();
}
