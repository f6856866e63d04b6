#version 300 es
// The picture: blended Gaussians over the background, beside or against the ground truth.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D blended;
uniform sampler2D environment, truth;
uniform bool hasEnvironment;
uniform vec3 background;
uniform vec2 size, focal, centre;  // pixels
uniform mat3 camToWorld;
uniform bool isDepth;
uniform vec2 range;   // of depth
uniform int compare;  // as COMPARE in renderer.js
uniform float wipe;   // share of the width that shows the render

out vec4 pixel;

const float pi = 3.14159265;
const float differenceGain = DIFFERENCE_GAIN;

vec3 scaleOfColours(float value) {  // inferno, by five of its colours
    const vec3 stops[5] = vec3[](vec3(0.001, 0.000, 0.014), vec3(0.342, 0.063, 0.429), vec3(0.735, 0.216, 0.330),
                                 vec3(0.976, 0.556, 0.035), vec3(0.988, 0.998, 0.645));
    float at = clamp(value, 0.0, 1.0) * 4.0;
    int below = min(int(at), 3);
    return mix(stops[below], stops[below + 1], at - float(below));
}

void main() {
    vec2 at = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);  // from the upper left corner
    vec4 sum = texelFetch(blended, ivec2(gl_FragCoord.xy), 0);
    vec3 behind = background;
    if (hasEnvironment) {  // model/environment_map.py
        vec3 ray = normalize(camToWorld * vec3((at - centre) / focal, 1.0));
        behind = textureLod(environment, vec2(atan(ray.x, ray.z) / (2.0 * pi), asin(ray.y) / pi) + 0.5, 0.0).rgb;
    }
    vec3 render = clamp(sum.rgb + (1.0 - sum.a) * behind, 0.0, 1.0);
    if (isDepth) {  // near is bright
        float depth = sum.r / max(sum.a, 1e-6);
        render = sum.a * scaleOfColours(1.0 - (depth - range.x) / (range.y - range.x));
    }
    if (compare != 0) {
        vec3 wanted = textureLod(truth, at / size, 0.0).rgb;
        if (compare == 1) render = wanted;
        if (compare == 2 && at.x > wipe * size.x) render = wanted;
        if (compare == 3) render = min(vec3(1.0), differenceGain * abs(render - wanted));
    }
    pixel = vec4(render, 1.0);
}
