// The viewer: reads its data, puts the parts together, and draws a picture whenever something changed.

import { poseOf } from "./camera.js";
import { Comparison } from "./comparison.js";
import { listenToKeys } from "./keys.js";
import { linkOf, stateOf } from "./link.js";
import { followTraining } from "./live.js";
import { bytesOfBase64, readModel } from "./model.js";
import { Navigation } from "./navigation.js";
import { figureOn, Pane } from "./pane.js";
import { Panel } from "./panel.js";
import { Stage } from "./stage.js";
import { $, initialState } from "./state.js";
import { Transport } from "./transport.js";
import { Truths } from "./truth.js";

const text = (id) => $(id).textContent;

async function start() {
    const header = JSON.parse(text("header"));
    const { scene } = header;
    const state = initialState(scene);
    state.pose = poseOf(scene.cameras[scene.reference].world_to_cam);
    const panes = makePanes(header);
    const truths = new Truths(scene.cameras, header.truths, bytesOfBase64(text("truths")));
    await Promise.all(
        panes.map(async (pane, i) => {
            if (header.models[i])
                pane.setModel(await readModel(header.models[i], bytesOfBase64(text(`model-${i}`)), scene));
        }),
    );
    const stage = new Stage(scene, state, panes, truths, $("stage"));
    if (header.live) await followTraining(panes[0], stage);

    const navigation = new Navigation(scene, state, $("stage"));
    const transport = new Transport(scene, state);
    const comparison = new Comparison(scene, state, truths, stage);
    const actions = {
        reset: () => navigation.reset(),
        leave: () => navigation.leaveFor(navigation.pose()),
        screenshot: () => saveScreenshot(stage, header),
        link: () => copyLink(state, scene),
        help: () => $("help").showModal(),
    };
    const panel = new Panel(scene, state, actions, truths);
    listenToKeys({ transport, comparison, panel, navigation, state, actions, help: $("help") });
    showFacts(header);
    const follow = () => {
        state.set(stateOf(location.hash, scene));
        if (state.compare !== "render") comparison.choose(state.compare);
    };
    addEventListener("hashchange", follow);
    follow();

    window.viewer = { scene, state, stage, picture: (camera, time, model) => stage.picture(camera, time, model) };
    await stage.draw(stage.detail);
    $("message").hidden = true;
    document.body.classList.add("ready");
    run({ stage, transport, navigation, comparison, panel });
}

function run({ stage, transport, navigation, comparison, panel }) {
    let before = performance.now();
    let behind = 0; // seconds of play that no picture has shown yet
    let measured = { at: before, frames: stage.frames };
    const tick = (now) => {
        const seconds = Math.min(0.1, (now - before) / 1000);
        before = now;
        behind = Math.min(0.5, behind + Math.max(seconds, 0));
        if (!stage.drawing) {
            transport.advance(behind);
            behind = 0;
        }
        navigation.fly(seconds);
        stage.update();
        if (stage.shown) comparison.follow(stage.shown.view);
        if (now - measured.at > 500) {
            panel.measure(stage.panes, stage.shown, (1000 * (stage.frames - measured.frames)) / (now - measured.at));
            measured = { at: now, frames: stage.frames };
        }
        requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
}

function makePanes(header) {
    const shaders = {};
    for (const name of ["cover", "preprocess", "splatCorners", "splat", "compose"])
        shaders[name] = text(`shader-${name}`).trim();
    const workerUrl = URL.createObjectURL(new Blob([text("sorter")], { type: "text/javascript" }));
    return header.labels.map((label) => {
        const element = figureOn($("stage"), header.labels.length > 1 ? label : "");
        element.firstChild.addEventListener("webglcontextlost", () =>
            say("The graphics driver dropped the scene: reload the page.", true),
        );
        return new Pane(element, label, shaders, workerUrl);
    });
}

function showFacts(header) {
    $("scene-name").textContent = header.scene.name;
    $("scene-facts").textContent = header.facts;
    for (const note of header.notes)
        $("notes").lastElementChild.append(Object.assign(document.createElement("li"), { textContent: note }));
}

async function saveScreenshot(stage, header) {
    await stage.settled();
    stage.panes.forEach((pane, i) => {
        pane.renderer.canvas.toBlob((blob) => {
            const link = document.createElement("a");
            const { view } = stage.shown;
            link.href = URL.createObjectURL(blob);
            link.download = `${[header.scene.name, header.labels[i], view.time.toFixed(3)].join("_").replace(/[^\w.-]+/g, "-")}.png`;
            link.click();
            URL.revokeObjectURL(link.href);
        });
    });
}

async function copyLink(state, scene) {
    const link = linkOf(state, scene);
    history.replaceState(null, "", link);
    try {
        await navigator.clipboard.writeText(location.href);
        say("The link is copied.");
    } catch {
        say("The link is in the address bar.");
    }
}

function say(words, lasting = false) {
    const message = $("message");
    message.textContent = words;
    message.hidden = false;
    if (!lasting) setTimeout(() => (message.hidden = true), 2000);
}

start().catch((error) => {
    say(`The scene cannot be shown: ${error.message}`, true);
    throw error;
});
