#version 300 es
// One fragment a Gaussian in view, nearest first: condition on time, project, colour. The stages and their rules are the
// kernel's: slice_in_time.hpp, project_ewa.hpp and sh.hpp.
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp isampler2D;
precision highp usampler2D;

uniform usampler2D order;    // rows of the Gaussians in view
uniform sampler2D geometry;  // four texels a Gaussian
uniform isampler2D sh;       // coefficients × orders texels a Gaussian
uniform sampler2D weights;   // a texel a trajectory and Gaussian
uniform sampler2D table;     // three texels a trajectory: displacement, rotation vector, velocity
uniform int trajectories;    // that Gaussians share
uniform int count;           // Gaussians in view
uniform float shStep;        // value of one step of sh
uniform int coefficients, orders;

uniform float time, duration;
uniform vec2 focal, centre, size;  // pixels
uniform mat3 worldToCam;
uniform vec3 position;   // of the camera
uniform float dilation;  // px²

uniform int colourBy;  // as COLOUR_BY in renderer.js
uniform vec2 range;    // of what is shown by colour

layout(location = 0) out vec4 place;   // mean x, y in pixels (y down); shear; opacity · p(t)
layout(location = 1) out vec4 shape;   // the two half axes of one standard deviation, sheared; depth
layout(location = 2) out vec4 colour;  // RGB

const float frustumMargin = FRUSTUM_MARGIN;

vec4 row(sampler2D source, int index) {
    int width = textureSize(source, 0).x;
    return texelFetch(source, ivec2(index % width, index / width), 0);
}

mat3 rotationOf(vec4 q) {  // (x, y, z, w)
    vec3 v = q.xyz * 2.0;
    vec3 d = q.xyz * v, w = q.w * v;
    float xy = q.x * v.y, xz = q.x * v.z, yz = q.y * v.z;
    return mat3(1.0 - d.y - d.z, xy + w.z, xz - w.y,
                xy - w.z, 1.0 - d.x - d.z, yz + w.x,
                xz + w.y, yz - w.x, 1.0 - d.x - d.y);
}

vec4 turning(vec3 r) {  // quaternion of the rotation by |r| about r
    float angle = length(r);
    return vec4((angle > 0.0 ? sin(0.5 * angle) / angle : 0.5) * r, cos(0.5 * angle));
}

vec3 coefficient(int gaussian, int index) {
    int texel = gaussian * coefficients * orders + index, width = textureSize(sh, 0).x;
    return vec3(texelFetch(sh, ivec2(texel % width, texel / width), 0).rgb);
}

// Y_lm of the unit direction d, the sum of the orders' coefficients each times its cosine.
vec3 radiance(int gaussian, vec3 d, float phase) {
    float basis[16];
    float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
    basis[0] = 0.28209479;
    basis[1] = -0.48860251 * y, basis[2] = 0.48860251 * z, basis[3] = -0.48860251 * x;
    basis[4] = 1.09254843 * x * y, basis[5] = -1.09254843 * y * z;
    basis[6] = 0.31539157 * (2.0 * zz - xx - yy);
    basis[7] = -1.09254843 * x * z, basis[8] = 0.54627422 * (xx - yy);
    basis[9] = -0.59004359 * y * (3.0 * xx - yy), basis[10] = 2.89061144 * x * y * z;
    basis[11] = -0.45704580 * y * (4.0 * zz - xx - yy);
    basis[12] = 0.37317633 * z * (2.0 * zz - 3.0 * (xx + yy));
    basis[13] = -0.45704580 * x * (4.0 * zz - xx - yy), basis[14] = 1.44530572 * z * (xx - yy);
    basis[15] = -0.59004359 * x * (xx - 3.0 * yy);
    vec3 sum = vec3(0.0);
    for (int n = 0; n < orders; ++n) {
        float cosine = cos(6.28318531 * float(n) * phase);
        for (int lm = 0; lm < coefficients; ++lm)
            sum += cosine * basis[lm] * coefficient(gaussian, n * coefficients + lm);
    }
    return max(vec3(0.0), 0.5 + shStep * sum);
}

vec3 scaleOfColours(float value) {  // viridis, by five of its colours
    const vec3 stops[5] = vec3[](vec3(0.267, 0.005, 0.329), vec3(0.230, 0.322, 0.546), vec3(0.128, 0.567, 0.551),
                                 vec3(0.369, 0.789, 0.383), vec3(0.993, 0.906, 0.144));
    float at = clamp(value, 0.0, 1.0) * 4.0;
    int below = min(int(at), 3);
    return mix(stops[below], stops[below + 1], at - float(below));
}

void main() {
    int slot = int(gl_FragCoord.y) * textureSize(order, 0).x + int(gl_FragCoord.x);
    place = shape = colour = vec4(0.0);
    if (slot >= count) return;
    int gaussian = int(texelFetch(order, ivec2(gl_FragCoord.xy), 0).r);
    vec4 meanTime = row(geometry, 4 * gaussian), motion = row(geometry, 4 * gaussian + 1);
    vec4 scaleOpacity = row(geometry, 4 * gaussian + 2);

    // Slice in time. motion.w is 1/σt, 0 in a static model.
    float elapsed = time - meanTime.w, deviations = elapsed * motion.w;
    vec3 displacement = vec3(0.0), turn = vec3(0.0), velocity = motion.xyz;
    for (int k = 0; k < trajectories; ++k) {
        float weight = row(weights, gaussian * trajectories + k).r;
        displacement += weight * texelFetch(table, ivec2(0, k), 0).xyz;
        turn += weight * texelFetch(table, ivec2(1, k), 0).xyz;
        velocity += weight * texelFetch(table, ivec2(2, k), 0).xyz;
    }
    vec3 offset = meanTime.xyz - position + motion.xyz * elapsed + displacement;
    float opacity = scaleOpacity.w * exp(-0.5 * deviations * deviations);

    // Project: B = J W A, Σ2d = B Bᵀ + dilation, its determinant from the minors of B.
    vec3 cam = worldToCam * offset;
    vec2 normalised = cam.xy / cam.z;
    vec2 clamped = clamp(normalised, -frustumMargin * centre / focal, frustumMargin * (size - centre) / focal);
    mat3 rows = transpose(worldToCam);
    vec3 jw0 = focal.x / cam.z * (rows[0] - clamped.x * rows[2]);
    vec3 jw1 = focal.y / cam.z * (rows[1] - clamped.y * rows[2]);
    mat3 axes = rotationOf(row(geometry, 4 * gaussian + 3));
    if (trajectories > 0) axes = rotationOf(turning(turn)) * axes;
    vec3 b0 = (jw0 * axes) * scaleOpacity.xyz, b1 = (jw1 * axes) * scaleOpacity.xyz;
    vec3 minors = cross(b0, b1);
    float norm0 = dot(b0, b0), norm1 = dot(b1, b1);
    float determinant = dot(minors, minors) + dilation * (norm0 + norm1) + dilation * dilation;
    float varianceY = norm1 + dilation;
    place = vec4(focal * normalised + centre, -dot(b0, b1) / varianceY, opacity);
    shape = vec4(sqrt(determinant / varianceY), sqrt(varianceY), cam.z, 0.0);

    if (colourBy == 0) {
        float phase = duration > 0.0 ? elapsed / duration : 0.0;
        colour.rgb = radiance(gaussian, normalize(offset), phase - round(phase));
    } else if (colourBy == 1) {
        colour.rgb = scaleOfColours((-log(motion.w) - range.x) / (range.y - range.x));
    } else if (colourBy == 2) {
        colour.rgb = scaleOfColours((length(velocity) - range.x) / (range.y - range.x));
    } else {
        colour.rgb = vec3(cam.z, 0.0, 0.0);
    }
}
