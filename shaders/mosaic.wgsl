// Light behind the filters of a mosaic: what came through one of them goes to its pixels. Twin: `mosaic` of src/imaging/mosaic.rs

struct Filter {
    // 0 red, 1 green, 2 blue.
    number: u32,
    // Whether the mosaic holds light already.
    goes_on: u32,
    unused_0: u32,
    unused_1: u32,
}

@group(0) @binding(1) var<uniform> filter_of: Filter;
@group(0) @binding(2) var<storage, read> through: array<f32>;
@group(0) @binding(3) var<storage, read_write> behind: array<f32>;

@compute @workgroup_size(64)
fn mosaic(@builtin(workgroup_id) group: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = (group.y * groups.x + group.x) * 64u + local;
    if (index >= frame.pixels) {
        return;
    }
    let pixel = pixel_at(index);
    let of_pixel = select(1u, 2u * (pixel.x & 1u), (pixel.x & 1u) == (pixel.y & 1u));
    let before = select(0.0, behind[index], filter_of.goes_on == 1u);
    behind[index] = before + select(0.0, through[index], of_pixel == filter_of.number);
}
