//! A star tracker that reads the truth and answers with errors of a known size, and with a fault where one is asked for: what `boresight test` itself is
//! tried with. No tracker is made like this.
//!
//! ```sh
//! cargo run --example planted_tracker -- FAULT --truth TRUTH.json --answer ANSWER [--sidecars]   # a frame
//! cargo run --example planted_tracker -- FAULT --stream [--sidecars]                             # lines of JSON on stdin and stdout
//! ```

use std::error::Error;
use std::io::{BufRead, Write};
use std::path::Path;

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use serde_json::{Value, json};

const ARCSEC_RAD: f64 = std::f64::consts::PI / 180.0 / 3600.0;
const LIGHT_KM_S: f64 = 299_792.458;
/// Standard errors of each axis across the boresight, of the roll, and of a centroid.
const CROSS_ARCSEC: f64 = 2.0;
const ABOUT_ARCSEC: f64 = 10.0;
const CENTROID_PX: f64 = 0.05;

/// What is true of a frame.
struct Truth {
    frame: u64,
    camera_from_icrs: Matrix3<f64>,
    velocity_km_s: Vector3<f64>,
    size_px: [f64; 2],
    focal_length_px: f64,
    stars: Vec<[f64; 5]>,
}

/// An answer on its way to a file or a stream.
struct Planted {
    status: &'static str,
    quaternion: [f64; 4],
    /// Column, row, flux, number of the star.
    centroids: Vec<[f64; 4]>,
    focal_length_px: f64,
}

fn truth(text: &str) -> Result<Truth, Box<dyn Error>> {
    let value: Value = serde_json::from_str(text)?;
    let numbers = |value: &Value| -> Vec<f64> { value.as_array().into_iter().flatten().map(|own| own.as_f64().unwrap_or(0.0)).collect() };
    let q = numbers(&value["camera_from_icrs"]);
    let [i, j, k, w] = *q.as_slice() else { return Err("camera_from_icrs is no quaternion".into()) };
    let velocity = numbers(&value["velocity_km_s"]);
    let camera = &value["camera"];
    let number = |key: &str| camera[key].as_f64().unwrap_or(0.0);
    let star = |star: &Value| -> [f64; 5] { numbers(star).try_into().unwrap_or([0.0; 5]) };
    Ok(Truth {
        frame: value["frame"].as_u64().unwrap_or(0),
        camera_from_icrs: *UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)).to_rotation_matrix().matrix(),
        velocity_km_s: Vector3::from_iterator(velocity.into_iter().chain([0.0; 3]).take(3)),
        size_px: [number("width_px"), number("height_px")],
        focal_length_px: number("focal_length_px"),
        stars: value["stars"].as_array().into_iter().flatten().map(star).filter(|star| star[4] >= 10.0).collect(),
    })
}

/// The turn that moves everything on the frame by so many pixels.
fn shift(px: [f64; 2], focal_length_px: f64) -> Matrix3<f64> {
    let there = Vector3::new(px[0], px[1], focal_length_px).normalize();
    Rotation3::rotation_between(&Vector3::z(), &there).map_or_else(Matrix3::identity, |turn| *turn.matrix())
}

/// The quaternion, scalar last, of a matrix by the formula of Shepperd, with no look whether it is mirrored.
fn quaternion(m: &Matrix3<f64>) -> [f64; 4] {
    let t = m.trace();
    let candidates = [m[(0, 0)], m[(1, 1)], m[(2, 2)], t];
    let largest = (0..4).fold(0, |best, next| if candidates[next] > candidates[best] { next } else { best });
    let q = match largest {
        3 => [m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)], 1.0 + t],
        0 => [1.0 + 2.0 * m[(0, 0)] - t, m[(0, 1)] + m[(1, 0)], m[(0, 2)] + m[(2, 0)], m[(2, 1)] - m[(1, 2)]],
        1 => [m[(0, 1)] + m[(1, 0)], 1.0 + 2.0 * m[(1, 1)] - t, m[(1, 2)] + m[(2, 1)], m[(0, 2)] - m[(2, 0)]],
        _ => [m[(0, 2)] + m[(2, 0)], m[(1, 2)] + m[(2, 1)], 1.0 + 2.0 * m[(2, 2)] - t, m[(1, 0)] - m[(0, 1)]],
    };
    let norm = q.iter().map(|own| own * own).sum::<f64>().sqrt();
    q.map(|own| own / norm)
}

fn planted(fault: &str, truth: &Truth) -> Planted {
    let mut chance = Pcg64::seed_from_u64(truth.frame + 1);
    let mut normal = || -> f64 { StandardNormal.sample(&mut chance) };
    let f = truth.focal_length_px;
    let noise = Vector3::new(CROSS_ARCSEC * normal(), CROSS_ARCSEC * normal(), ABOUT_ARCSEC * normal()) * ARCSEC_RAD;
    let mut matrix = Rotation3::from_scaled_axis(noise).matrix() * truth.camera_from_icrs;
    let [width, height] = truth.size_px;
    let middle = [(width - 1.0) / 2.0, (height - 1.0) / 2.0];
    let mut move_px: Box<dyn Fn([f64; 2]) -> [f64; 2]> = Box::new(|place| place);
    match fault {
        "y-flipped" => {
            matrix = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0)) * matrix;
            move_px = Box::new(move |[x, y]| [x, height - 1.0 - y]);
        }
        "mirrored" => {
            matrix = Matrix3::from_diagonal(&Vector3::new(-1.0, 1.0, 1.0)) * matrix;
            move_px = Box::new(move |[x, y]| [width - 1.0 - x, y]);
        }
        "half-pixel" => {
            matrix = shift([0.5, 0.5], f) * matrix;
            move_px = Box::new(|[x, y]| [x + 0.5, y + 0.5]);
        }
        "middle" => {
            matrix = shift(middle.map(|own| -own), f) * matrix;
            move_px = Box::new(move |[x, y]| [x - middle[0], y - middle[1]]);
        }
        "conjugated" => matrix.transpose_mut(),
        "aberration" => {
            // A catalogue direction at the boresight is taken for the one that its light has.
            let boresight = matrix.row(2).transpose();
            matrix *= Rotation3::from_scaled_axis(boresight.cross(&(truth.velocity_km_s / LIGHT_KM_S))).matrix();
        }
        _ => {}
    }
    let [i, j, k, w] = quaternion(&matrix);
    let quaternion = if fault == "scalar-first" { [w, i, j, k] } else { [i, j, k, w] };
    let mut centroids: Vec<[f64; 4]> = truth
        .stars
        .iter()
        .map(|[x, y, flux, hip, _]| {
            let [x, y] = move_px([x + CENTROID_PX * normal(), y + CENTROID_PX * normal()]);
            [x, y, *flux, *hip]
        })
        .collect();
    if fault == "wrong-ids" {
        let hips: Vec<f64> = centroids.iter().map(|star| star[3]).collect();
        for (place, star) in centroids.iter_mut().enumerate() {
            if (place as u64 * 7 + truth.frame * 3).is_multiple_of(20) {
                star[3] = hips[(place + 1) % hips.len()];
            }
        }
    }
    // Of a thousand frames, so many are answered wrongly.
    let wrong = fault.strip_prefix("false-per-1000=").and_then(|number| number.parse::<u64>().ok()).unwrap_or(0);
    let is_wrong = truth.frame.wrapping_mul(7919) % 1000 < wrong;
    Planted {
        status: if fault == "silent" { "none" } else { "solved" },
        quaternion: if is_wrong { [0.5, 0.5, 0.5, 0.5] } else { quaternion },
        centroids,
        focal_length_px: if fault == "focal-length" { 1.001 * f } else { f },
    }
}

/// Crashes and hangs come at every fifth frame.
fn end(fault: &str, frame: u64) {
    if frame % 5 == 3 && fault == "crash" {
        std::process::abort();
    }
    if frame % 5 == 3 && fault == "hang" {
        std::thread::sleep(std::time::Duration::from_secs(3600));
    }
}

fn write_frame(fault: &str, truth: &Truth, answer: &Path, sidecars: bool) -> Result<(), Box<dyn Error>> {
    let own = planted(fault, truth);
    let [a, b, c, d] = own.quaternion;
    let text = match fault {
        "garbage" => "\u{1b}[31mno stars?\n".to_owned(),
        "partial" => format!("frame,status,qi,qj,qk,qw\n{},solved,{a},{b}", truth.frame),
        _ => format!("frame,status,qi,qj,qk,qw\n{},{},{a},{b},{c},{d}\n", truth.frame, own.status),
    };
    std::fs::write(answer, text)?;
    if sidecars {
        let folder = answer.parent().unwrap_or(Path::new("."));
        let mut table = "frame,x,y,flux,id\n".to_owned();
        for [x, y, flux, hip] in &own.centroids {
            table += &format!("{},{x},{y},{flux},{hip}\n", truth.frame);
        }
        std::fs::write(folder.join("centroids.csv"), table)?;
        std::fs::write(folder.join("camera.json"), json!({"focal_length_px": own.focal_length_px}).to_string())?;
    }
    Ok(())
}

fn stream(fault: &str, sidecars: bool) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let asked: Value = serde_json::from_str(&line?)?;
        let truth = truth(&std::fs::read_to_string(asked["truth"].as_str().unwrap_or_default())?)?;
        end(fault, truth.frame);
        let own = planted(fault, &truth);
        let mut answer = json!({"frame": truth.frame, "status": own.status, "quaternion": own.quaternion});
        if sidecars {
            answer["centroids"] = json!(own.centroids);
            answer["camera"] = json!({"focal_length_px": own.focal_length_px});
        }
        if fault == "garbage" {
            writeln!(out, "no stars?")?;
        } else {
            writeln!(out, "{answer}")?;
        }
        out.flush()?;
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let after = |name: &str| words.iter().position(|word| word == name).and_then(|at| words.get(at + 1));
    let fault = words.first().ok_or("name a fault, or `none`")?;
    let sidecars = words.iter().any(|word| word == "--sidecars");
    if words.iter().any(|word| word == "--stream") {
        return stream(fault, sidecars);
    }
    let truth = truth(&std::fs::read_to_string(after("--truth").ok_or("--truth is missing")?)?)?;
    end(fault, truth.frame);
    write_frame(fault, &truth, Path::new(after("--answer").ok_or("--answer is missing")?), sidecars)
}
