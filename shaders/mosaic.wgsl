// Light behind the filters of a mosaic: what came through one of them goes to its pixels; an invocation is four of them.
// Twin: `mosaic` of src/imaging/mosaic.rs

struct Filter {
    // 0 red, 1 green, 2 blue.
    number: u32,
    // Whether the mosaic holds light already.
    goes_on: u32,
    unused_0: u32,
    unused_1: u32,
}

@group(0) @binding(1) var<uniform> filter_of: Filter;
@group(0) @binding(2) var<storage, read> through: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> behind: array<vec4<f32>>;

@compute @workgroup_size(64)
fn mosaic(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let quad = (group.y * groups.x + group.x) * 64u + local;
    if (4u * quad >= frame.pixels) {
        return;
    }
    let first = pixel_at(4u * quad);
    let second = next_pixel(first);
    let third = next_pixel(second);
    let fourth = next_pixel(third);
    let x = vec4<u32>(first.x, second.x, third.x, fourth.x) & vec4<u32>(1u);
    let y = vec4<u32>(first.y, second.y, third.y, fourth.y) & vec4<u32>(1u);
    let of_pixel = select(vec4<u32>(1u), 2u * x, x == y);
    let before = select(vec4<f32>(0.0), behind[quad], filter_of.goes_on == 1u);
    behind[quad] = before + select(vec4<f32>(0.0), through[quad], of_pixel == vec4<u32>(filter_of.number));
}
