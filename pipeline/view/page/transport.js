// Play, slider, step, speed. In a static scene playing turns the view instead.

import { orbited } from "./camera.js";
import { $ } from "./state.js";

const TURN = 0.4; // radians a second, of a static scene

const PLAY = '<svg viewBox="0 0 24 24"><path d="M7 4v16l13-8z"/></svg>';
const PAUSE = '<svg viewBox="0 0 24 24"><path d="M6 4h4v16H6zm8 0h4v16h-4z"/></svg>';

export class Transport {
    constructor(scene, state) {
        Object.assign(this, { scene, state });
        $("transport").classList.toggle("static", scene.static);
        $("time").min = scene.start;
        $("time").max = scene.end;
        $("play").onclick = () => this.toggle();
        $("step-back").onclick = () => this.step(-1);
        $("step-on").onclick = () => this.step(1);
        $("time").oninput = () => state.set({ time: Number($("time").value), playing: false });
        $("speed").onchange = () => state.set({ speed: Number($("speed").value) });
        state.listen(() => this.show());
        this.show();
    }

    show() {
        const { scene, state } = this;
        const icon = state.playing ? "pause" : "play";
        if (this.icon !== icon) {
            $("play").innerHTML = state.playing ? PAUSE : PLAY;
            this.icon = icon;
        }
        $("time").value = state.time;
        $("time").style.setProperty("--done", `${(100 * (state.time - scene.start)) / (scene.end - scene.start)}%`);
        const [now, all] = [state.time - scene.start, scene.end - scene.start].map((t) => (t * scene.clock).toFixed(2));
        $("clock").value = `${now} / ${all}${scene.unit}`;
        $("speed").value = String(state.speed);
    }

    toggle() {
        this.state.set({ playing: !this.state.playing });
    }

    // One frame of the data on or back, round the end.
    step(frames) {
        this.state.set({ playing: false, time: this.wrapped(this.state.time + frames * this.scene.frame_spacing) });
    }

    wrapped(time) {
        const { start, end } = this.scene;
        if (time > end) return start;
        return time < start ? end : time;
    }

    advance(seconds) {
        const { scene, state } = this;
        if (!state.playing) return;
        if (scene.static) {
            if (state.camera === null)
                state.set({ pose: orbited(state.pose, scene.middle, scene.up, seconds * state.speed * TURN, 0) });
            return;
        }
        const by = (seconds * state.speed * (scene.end - scene.start)) / scene.seconds;
        state.set({ time: this.wrapped(state.time + by) });
    }
}
