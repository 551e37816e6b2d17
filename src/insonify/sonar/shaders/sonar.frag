#version 430
// The channels of Cerqueira et al. 2017, section 3.2, for one pixel: intensity (as an echo),
// distance, angle; and what the pixel stands for: its share of the beam and its extent in range.
uniform vec2 half_fov;         // azimuth, elevation, rad
uniform float camera_azimuth;  // of this camera's axis, rad
uniform vec2 pixel;            // width and height on the image plane at unit distance
uniform float beam_rad;
uniform float limit_m;
uniform float least_facing;
uniform vec4 response;  // law, slope, centre, beam pattern
uniform float strength;
uniform float body;
uniform bool bumpy;
uniform sampler2D normal_map;
in vec3 point;
in vec2 uv;
layout(location = 0) out vec4 channels;  // echo, distance, azimuth, weight
layout(location = 1) out vec4 patch_of;  // rise, skew, body, elevation

// The normal map's normal in the sonar frame: TBN of the triangle, from how uv lies on it.
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
    vec2 ux = dFdx(uv), uy = dFdy(uv);
    float r = length(point);
    vec3 d = point / r;
    float azimuth = atan(d.y, d.x), elevation = asin(d.z);
    if (r > limit_m || abs(azimuth) > half_fov.x || abs(elevation) > half_fov.y) discard;
    vec3 n = cross(dx, dy);
    float size = length(n);
    if (size == 0.0) discard;
    n /= size;
    if (dot(n, d) > 0.0) n = -n;
    float flat_d = length(d.xy), off = cos(azimuth - camera_azimuth);
    float step_az = pixel.x * off * off;
    float step_el = pixel.y * off * flat_d * flat_d;
    float per_rad = r / max(abs(dot(n, d)), least_facing);
    float rise = per_rad * abs(n.z * flat_d - d.z * dot(n.xy, d.xy) / flat_d) * step_el;
    float skew = per_rad * abs(n.y * d.x - n.x * d.y) * step_az;
    vec3 shading = bumpy ? bent(n, dx, dy, ux, uy) : n;
    float cosine = abs(dot(shading, d));
    float echo = response.x > 0.0
        ? strength * cosine * flat_d
        : 1.0 / (1.0 + exp(-response.y * (min(1.0, cosine * strength) - response.z)));
    float u = abs(3.14159265 * response.w * d.z);
    float pressure = u < 1e-4 ? 1.0 : sin(u) / u;
    echo *= response.w >= 0.0 ? exp(-response.w * elevation * elevation) : pow(pressure * pressure, 2.0);
    float weight = step_az * step_el / (beam_rad * 2.0 * half_fov.y);
    channels = vec4(echo, r, azimuth, weight);
    patch_of = vec4(rise, skew, body, elevation);
}
