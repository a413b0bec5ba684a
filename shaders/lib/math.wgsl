// Elementary functions as polynomials, the same lines as src/effects/pixel/math.rs: built-in functions differ between drivers.
// Sources: ln, exp, sin and cos are the single-precision polynomials of the Cephes library (S. L. Moshier).

const RECIPROCAL_SQRT_2 = 0.70710678118654752;

// Natural logarithm of a normal positive number.
fn poly_ln(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    let m0 = bitcast<f32>((bits & 0x007fffffu) | 0x3f000000u); // in [1/2, 1)
    let small = m0 < RECIPROCAL_SQRT_2;
    let m = select(m0 - 1.0, m0 + m0 - 1.0, small);
    let e = f32(i32(bits >> 23u) - 126) - select(0.0, 1.0, small);
    let z = m * m;
    var p = 7.0376836292e-2;
    p = p * m - 1.1514610310e-1;
    p = p * m + 1.1676998740e-1;
    p = p * m - 1.2420140846e-1;
    p = p * m + 1.4249322787e-1;
    p = p * m - 1.6668057665e-1;
    p = p * m + 2.0000714765e-1;
    p = p * m - 2.4999993993e-1;
    p = p * m + 3.3333331174e-1;
    let y = p * m * z - 2.12194440e-4 * e - 0.5 * z;
    return m + y + 0.693359375 * e;
}

// Exponential of a number in [-87, 0].
fn poly_exp(x: f32) -> f32 {
    let n = i32(x * 1.44269504088896341 - 0.5); // truncated towards zero: the nearest integer
    let r = x - f32(n) * 0.693359375 + f32(n) * 2.12194440e-4;
    var p = 1.9875691500e-4;
    p = p * r + 1.3981999507e-3;
    p = p * r + 8.3334519073e-3;
    p = p * r + 4.1665795894e-2;
    p = p * r + 1.6666665459e-1;
    p = p * r + 5.0000001201e-1;
    return (p * (r * r) + r + 1.0) * bitcast<f32>(u32(n + 127) << 23u);
}

// Cosine and sine of an angle given as a part of a turn in units of 2^-32: the reduction to an octant is exact.
fn cos_sin_turn(turn: u32) -> vec2<f32> {
    let quadrant = (turn + 0x20000000u) >> 30u;
    let x = f32(i32(turn - (quadrant << 30u))) * 1.46291807926715968e-9; // (pi/2) / 2^30; in [-pi/4, pi/4]
    let z = x * x;
    let sine = ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * x + x;
    let cosine = ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * (z * z) - 0.5 * z + 1.0;
    let sizes = select(vec2<f32>(cosine, sine), vec2<f32>(sine, cosine), (quadrant & 1u) == 1u);
    // Signs are bits: the cosine's in the quadrants 1 and 2, the sine's in 2 and 3.
    let signs = (vec2<u32>(quadrant + 1u, quadrant) & vec2<u32>(2u)) << vec2<u32>(30u);
    return bitcast<vec2<f32>>(bitcast<vec2<u32>>(sizes) ^ signs);
}

// The cosine alone.
fn cos_turn(turn: u32) -> f32 {
    return cos_sin_turn(turn).x;
}

// A word as a number in (0, 1], fine near 0.
fn unit_interval(word: u32) -> f32 {
    return (f32(i32(word >> 1u)) + 0.5) * 4.656612873077393e-10;
}

// Two standard normal numbers from two words (Box and Muller 1958).
fn normal_pair(radius_word: u32, angle_word: u32) -> vec2<f32> {
    return sqrt(-2.0 * poly_ln(unit_interval(radius_word))) * cos_sin_turn(angle_word);
}

// A standard normal number from two words.
fn standard_normal(radius_word: u32, angle_word: u32) -> f32 {
    return normal_pair(radius_word, angle_word).x;
}

// Probability that a standard normal number exceeds x >= 0.
fn normal_upper_tail(x_any: f32) -> f32 {
    let x = min(x_any, 12.0); // beyond lie numbers so small that processors are slow with them
    let t = 1.0 / (1.0 + 0.26 * x);
    var p = 0.0321890587012;
    p = p * t - 0.160858160315;
    p = p * t + 0.267731231854;
    p = p * t - 0.169100441049;
    p = p * t + 0.173176696023;
    p = p * t + 0.045955999474;
    p = p * t + 0.104291784814;
    p = p * t + 0.102844978828;
    p = p * t + 0.103768853929;
    return p * t * poly_exp(-0.5 * x * x);
}
