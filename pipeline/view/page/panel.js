// The panel at the side: camera, colours, background, what is measured while it plays.

import { $ } from "./state.js";

const format = new Intl.NumberFormat("en");

export class Panel {
    constructor(scene, state, actions, truths) {
        Object.assign(this, { scene, state, actions });
        this.fillCameras($("camera"), truths);
        $("camera").onchange = () => this.look($("camera").value);
        $("camera-before").onclick = () => this.next(-1);
        $("camera-after").onclick = () => this.next(1);
        $("colour-by").onchange = () => state.set({ colourBy: $("colour-by").value });
        $("background").oninput = () => state.set({ background: rgbOf($("background").value) });
        $("background-reset").onclick = () => state.set({ background: null });
        for (const id of ["reset", "screenshot", "link"]) $(id).onclick = actions[id];
        $("help-button").onclick = actions.help;
        $("panel-button").onclick = () => {
            const open = document.body.classList.toggle("panel-open");
            $("panel-button").setAttribute("aria-expanded", String(open));
        };
        if (!scene.has_time)
            for (const value of ["lifetime", "speed"]) $("colour-by").querySelector(`[value=${value}]`).remove();
        state.listen(() => this.show());
        this.show();
    }

    fillCameras(select, truths) {
        select.append(new Option("free view", "free"));
        for (const split of ["held out", "training"]) {
            const group = document.createElement("optgroup");
            group.label = split;
            this.scene.cameras.forEach((camera, index) => {
                if (camera.split === split)
                    group.append(new Option(camera.name + (truths.has(index) ? "" : " (no image)"), index));
            });
            select.append(group);
        }
    }

    look(value) {
        if (value === "free") {
            this.actions.leave();
            return;
        }
        const camera = this.scene.cameras[Number(value)];
        const changes = { camera: Number(value) };
        if (camera.frames.length === 1) Object.assign(changes, { time: camera.frames[0].time, playing: false });
        this.state.set(changes);
    }

    next(step) {
        const count = this.scene.cameras.length;
        const now = this.state.camera ?? (step > 0 ? -1 : count);
        this.look(String((now + step + count) % count));
    }

    show() {
        const { state } = this;
        $("camera").value = state.camera ?? "free";
        $("colour-by").value = state.colourBy;
        $("background").value = hexOf(state.background ?? this.scene.background);
        $("background-reset").disabled = state.background === null;
    }

    // Every half second: what was drawn since.
    measure(panes, shown, framesPerSecond) {
        const rows = [["frames a second", framesPerSecond > 0 ? framesPerSecond.toFixed(0) : "– (still)"]];
        panes.forEach((pane, i) => {
            const { count, trained } = pane.model.header;
            const of = panes.length > 1 ? `, ${pane.label}` : "";
            rows.push([`Gaussians alive${of}`, format.format(shown.sorted[i].alive)]);
            rows.push([`Gaussians${of}`, format.format(trained ?? count)]);
        });
        writeList($("numbers"), rows);
        this.legend(panes[0], shown);
    }

    legend(pane, { view, sorted }) {
        const legend = $("legend");
        const units = { lifetime: " of time", speed: " a unit of time", depth: "" };
        legend.hidden = !(view.colourBy in units);
        if (legend.hidden) return;
        let [low, high] = view.colourBy === "depth" ? sorted[0].depths : pane.model.ranges[view.colourBy];
        if (view.colourBy === "lifetime") [low, high] = [Math.exp(low), Math.exp(high)];
        if (view.colourBy === "depth") [low, high] = [high, low];
        legend.dataset.scale = view.colourBy === "depth" ? "depth" : "value";
        const [, first, last] = legend.children;
        first.textContent = low.toPrecision(2);
        last.textContent = high.toPrecision(2) + units[view.colourBy];
    }
}

export function writeList(list, rows) {
    while (list.children.length > 2 * rows.length) list.lastChild.remove();
    while (list.children.length < 2 * rows.length)
        list.append(document.createElement(list.children.length % 2 ? "dd" : "dt"));
    rows.forEach(([term, value], i) => {
        list.children[2 * i].textContent = term;
        list.children[2 * i + 1].textContent = value;
    });
}

const hexOf = (rgb) =>
    `#${rgb
        .map((x) =>
            Math.round(255 * x)
                .toString(16)
                .padStart(2, "0"),
        )
        .join("")}`;
const rgbOf = (hex) => [1, 3, 5].map((i) => Number.parseInt(hex.slice(i, i + 2), 16) / 255);
