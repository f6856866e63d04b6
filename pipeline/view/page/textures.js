// Small helpers around WebGL2: programs, textures and render targets.

export function contextOf(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL2, which the viewer draws with.");
    if (!gl.getExtension("EXT_color_buffer_float"))
        throw new Error("This graphics driver cannot draw into float textures (EXT_color_buffer_float).");
    return gl;
}

export class Program {
    constructor(gl, vertex, fragment) {
        this.gl = gl;
        this.program = gl.createProgram();
        for (const [type, source] of [
            [gl.VERTEX_SHADER, vertex],
            [gl.FRAGMENT_SHADER, fragment],
        ]) {
            const shader = gl.createShader(type);
            gl.shaderSource(shader, source);
            gl.compileShader(shader);
            gl.attachShader(this.program, shader);
            if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
                throw new Error(gl.getShaderInfoLog(shader));
        }
        gl.linkProgram(this.program);
        if (!gl.getProgramParameter(this.program, gl.LINK_STATUS) && !gl.isContextLost())
            throw new Error(gl.getProgramInfoLog(this.program));
        this.uniforms = {};
        for (let i = 0; i < gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS); ++i) {
            const { name, type } = gl.getActiveUniform(this.program, i);
            this.uniforms[name] = { at: gl.getUniformLocation(this.program, name), type };
        }
    }

    // values: numbers, arrays or, for a sampler, a texture. A uniform that the compiler dropped is passed over.
    use(values) {
        const gl = this.gl;
        const setters = {
            [gl.FLOAT]: (at, v) => gl.uniform1f(at, v),
            [gl.FLOAT_VEC2]: (at, v) => gl.uniform2fv(at, v),
            [gl.FLOAT_VEC3]: (at, v) => gl.uniform3fv(at, v),
            [gl.FLOAT_MAT3]: (at, v) => gl.uniformMatrix3fv(at, false, v),
            [gl.INT]: (at, v) => gl.uniform1i(at, v),
            [gl.BOOL]: (at, v) => gl.uniform1i(at, v ? 1 : 0),
        };
        gl.useProgram(this.program);
        let unit = 0;
        for (const [name, { at, type }] of Object.entries(this.uniforms)) {
            if (!(name in values)) throw new Error(`no value for the uniform ${name}`);
            if (setters[type]) {
                setters[type](at, values[name]);
            } else {
                gl.activeTexture(gl.TEXTURE0 + unit);
                gl.bindTexture(gl.TEXTURE_2D, values[name]);
                gl.uniform1i(at, unit++);
            }
        }
    }
}

// A texture of `width` columns that holds the texels of `data`, row after row; data null: of `height` empty rows.
export function dataTexture(gl, [internal, format, type], width, channels, data, height = 0) {
    const rows = data ? Math.max(1, Math.ceil(data.length / channels / width)) : height;
    let padded = data;
    if (data && data.length !== rows * width * channels) {
        padded = new data.constructor(rows * width * channels);
        padded.set(data);
    }
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, rows, 0, format, type, padded);
    filtered(gl, gl.NEAREST);
    return texture;
}

export function filtered(gl, filter, wrapS = gl.CLAMP_TO_EDGE) {
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, wrapS);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}

// A framebuffer that draws into `textures`, all of one size.
export function targetOf(gl, textures) {
    const framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    textures.forEach((texture, i) => {
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
    });
    gl.drawBuffers(textures.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
    return framebuffer;
}
