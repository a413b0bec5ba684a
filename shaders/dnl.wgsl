// Counts of unequal width. Twin and page: src/effects/detector/dnl.rs

struct DnlUniforms {
    edge_sigma_dn: f32,
    dn_per_e: f32,
    e_per_dn: f32,
    bias_dn: f32,
}

// Where the edge below a count lies beside its place.
fn edge(count: f32) -> f32 {
    let random = fixed_words(u32(count), DNL_STAGE, 0u);
    return clamp(effects.dnl.edge_sigma_dn * standard_normal(random.x, random.y), -0.45, 0.45);
}

fn dnl(electrons: f32, pixel: Pixel) -> f32 {
    let exact = max(electrons * effects.dnl.dn_per_e + effects.dnl.bias_dn + 0.5, 0.0);
    let count = floor(exact);
    let above = exact - count;
    let down = select(0.0, 1.0, above < edge(count));
    let up = select(0.0, 1.0, above - 1.0 >= edge(count + 1.0));
    return (count - down + up - effects.dnl.bias_dn) * effects.dnl.e_per_dn;
}
