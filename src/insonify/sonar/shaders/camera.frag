#version 430
// A surface in water: daylight from above and a lamp at the camera, dimmed by colour on its way,
// under a veil of scattered light that thickens with distance.
uniform vec3 up;           // world's upward axis, eye frame
uniform vec3 colour;       // of the material, linear
uniform vec3 haze;         // of open water, linear
uniform vec3 loss_per_m;   // beam attenuation by colour
uniform vec3 daylight;     // as bright and blue as it comes down, linear
uniform float lamp_power;
uniform float lamp_m;      // distance to which the lamp lights well
uniform bool bumpy;
uniform sampler2D normal_map;
in vec3 point;
in vec2 uv;
layout(location = 0) out vec4 picture;

vec3 bent(vec3 n, vec3 dx, vec3 dy, vec2 ux, vec2 uy) {
    float area = ux.x * uy.y - ux.y * uy.x;
    if (area == 0.0) return n;
    vec3 t = normalize((dx * uy.y - dy * ux.y) / area);
    vec3 along_v = (dy * ux.x - dx * uy.x) / area;
    vec3 b = cross(n, t);
    if (dot(b, along_v) < 0.0) b = -b;
    vec3 m = texture(normal_map, uv).xyz;
    return normalize(m.x * t + m.y * b + m.z * n);
}

void main() {
    vec3 dx = dFdx(point), dy = dFdy(point);
    float r = length(point);
    vec3 d = point / r;
    vec3 n = cross(dx, dy);
    float size = length(n);
    n = size > 0.0 ? n / size : -d;
    if (dot(n, d) > 0.0) n = -n;
    if (bumpy) n = bent(n, dx, dy, dFdx(uv), dFdy(uv));
    float day = (0.25 + 0.75 * max(dot(n, up), 0.0));
    float lamp = lamp_power * max(dot(n, -d), 0.0) / (1.0 + r * r / (lamp_m * lamp_m));
    vec3 seen = exp(-loss_per_m * r);
    vec3 light = colour * (day * daylight + lamp * exp(-loss_per_m * r));
    vec3 linear = light * seen + haze * (1.0 - seen);
    picture = vec4(pow(clamp(linear, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0);
}
