#version 430
// Vertices in the camera frame: x forward, y left, z up.
uniform mat4 eye_from_scene;
uniform mat4 clip_from_eye;
in vec3 position;
in vec2 texture_uv;
out vec3 point;
out vec2 uv;

void main() {
    vec4 p = eye_from_scene * vec4(position, 1.0);
    point = p.xyz;
    uv = texture_uv;
    gl_Position = clip_from_eye * p;
}
