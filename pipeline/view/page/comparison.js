// The ground truth: instead of the render, beside it, behind a line that can be dragged, or as a difference.

import { add, dot, length, poseOf } from "./camera.js";
import { figureOn } from "./pane.js";
import { $ } from "./state.js";

export class Comparison {
    constructor(scene, state, truths, stage) {
        Object.assign(this, { scene, state, truths, stage, buttons: [...$("compare").children] });
        for (const button of this.buttons) button.onclick = () => this.choose(button.dataset.compare);
        this.line = document.createElement("div");
        this.line.id = "wipe";
        this.line.dataset.noDrag = "";
        this.line.innerHTML = "<b>render</b><i>‹ ›</i><b>truth</b>";
        stage.panes[0].element.append(this.line);
        this.line.addEventListener("pointerdown", (event) => this.line.setPointerCapture(event.pointerId));
        this.line.addEventListener("pointermove", (event) => this.drag(event));
        this.beside = figureOn(stage.element, "ground truth");
        this.beside.classList.add("truth");
        state.listen(() => this.show());
        this.show();
    }

    // Shows the truth of the camera that is looked through; from a free view goes to the nearest one that has it.
    choose(compare) {
        const { state, truths } = this;
        if (compare === "render") {
            state.set({ compare });
            return;
        }
        let camera = state.camera;
        if (camera === null || !truths.has(camera)) camera = this.nearest();
        if (camera === null) return;
        const { frames } = this.scene.cameras[camera];
        const frame = truths.nearest(camera, state.time);
        state.set({ compare, camera, time: frame.time, playing: state.playing && frames.length > 1 });
    }

    // The camera with a truth nearest in place, direction and time.
    nearest() {
        const { scene, state, truths } = this;
        const pose = state.camera === null ? state.pose : poseOf(scene.cameras[state.camera].world_to_cam);
        const far = (index) => {
            const other = poseOf(scene.cameras[index].world_to_cam);
            const away = length(add(other.position, pose.position, -1)) / scene.size;
            const apart = Math.abs(truths.nearest(index, state.time).time - state.time) / (scene.end - scene.start);
            return away + (1 - dot(other.forward, pose.forward)) + 0.5 * apart;
        };
        const candidates = scene.cameras.map((_, index) => index).filter((index) => truths.has(index));
        return candidates.length ? candidates.reduce((a, b) => (far(b) < far(a) ? b : a)) : null;
    }

    show() {
        const { state } = this;
        const compare = state.camera === null ? "render" : state.compare;
        for (const button of this.buttons)
            button.setAttribute("aria-pressed", String(button.dataset.compare === compare));
        this.line.hidden = compare !== "wipe";
        this.beside.hidden = compare !== "beside";
    }

    drag(event) {
        if (!event.buttons) return;
        const box = this.stage.panes[0].renderer.canvas.getBoundingClientRect();
        this.state.set({ wipe: Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)) });
    }

    // After a picture was drawn: the line lies where the canvas has it, and the image beside is the view's.
    follow(view) {
        const { canvas } = this.stage.panes[0].renderer;
        this.line.style.left = `${canvas.offsetLeft + this.state.wipe * canvas.offsetWidth}px`;
        if (this.beside.hidden || !view.truth) return;
        const [picture] = this.beside.children;
        if (this.besideShown === view.truth) return;
        picture.width = view.truth.width;
        picture.height = view.truth.height;
        picture.getContext("2d").drawImage(view.truth, 0, 0);
        this.besideShown = view.truth;
    }
}
