use boresight::calibrate::trial::Trial;
use boresight::camera::Camera;
use boresight::catalog::Catalog;
use boresight::diagnose::*;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let kind = args[1].as_str();
    let amp: f64 = args[2].parse().unwrap();
    let seeds: u64 = args[3].parse().unwrap();
    let catalog = Catalog::embedded().unwrap();
    let truth = Camera { principal_point_px: [514.0, 509.0], k1: 3e-9, p1: 1e-7, p2: -1e-7, ..Camera::pinhole(1024, 1024, 2900.0) };
    for seed in 0..seeds {
        let trial = Trial { truth, nominal: Camera::pinhole(1024, 1024, 2900.0), frames: 40, stars_per_frame: 32, noise_px: 0.05, ..Trial::published() };
        let mut night = trial.night(&catalog, seed + 1000).control_points;
        let n = night.attitudes.len();
        night.frames = (0..n).map(|f| { let mut s = boresight::identify::FrameState::default();
            s.observation.time_offset_h = Some(f as f64 * 0.1 - 2.0);
            s.observation.temperature_offset_k = Some(5.0 * (f as f64 * 2.3 + seed as f64).sin());
            s.observation.order_offset = Some(f as f64 - 19.5);
            s.observation.sensor = boresight::effects::Observation::of_sensor(1024, 1024).sensor; s }).collect();
        for p in &mut night.points {
            let (x, y) = (p.x_px - 511.5, p.y_px - 511.5);
            let (u, v) = (x / 512.0, y / 512.0);
            let f = night.frames[p.frame].observation;
            let c = p.colour.unwrap_or(0.6) - 0.6;
            let d = match kind {
                "null" => [0.0, 0.0],
                "lateral" => [c * u * amp, c * v * amp],
                "thermal" => [f.temperature_offset_k.unwrap() / 5.0 * u * amp, f.temperature_offset_k.unwrap() / 5.0 * v * amp],
                "aspect" => [amp * u, -amp * v],
                "k2" => { let r = u * u + v * v; [amp * r * r * u, amp * r * r * v] }
                "step" => if x > 100.0 { [amp, 0.0] } else { [0.0, 0.0] },
                "quad" => if x > 0.0 && y > 0.0 { [amp, 0.0] } else { [0.0, 0.0] },
                "bump" => { let (a, b) = ((x - 100.0) / 120.0, (y + 50.0) / 120.0); let g = amp * (-0.5 * (a * a + b * b)).exp(); [g * a, g * b] }
                "half" => if p.frame > n / 2 { [amp * u, amp * v] } else { [0.0, 0.0] },
                "jump" => if p.frame == 7 { [amp * u, amp * v] } else { [0.0, 0.0] },
                _ => panic!(),
            };
            p.x_px += d[0];
            p.y_px += d[1];
        }
        let opts = DiagnoseOptions { seed, nulls: args.get(4).map_or(1000, |s| s.parse().unwrap()), ..DiagnoseOptions::default() };
        let t = std::time::Instant::now();
        let d = diagnose(&night, &Vec::new(), &opts).unwrap();
        println!("{seed} {:?} p {:.1e} ({}) m {:.0} t {:.2}s rms {:.4}->{:.4} chi {:.3} {:?} -> {:.3} {:?} noise {:?}", d.verdict, d.channels.astrometry.as_ref().unwrap().p_value, d.channels.astrometry.as_ref().unwrap().largest, d.effective_hypotheses, t.elapsed().as_secs_f64(), d.fit.baseline.rms_px, d.fit.after.rms_px, d.fit.baseline.chi2_per_dof, d.fit.baseline.held_out_chi2_per_dof, d.fit.after.chi2_per_dof, d.fit.after.held_out_chi2_per_dof, d.noise);
        if args.len() > 5 || kind != "null" { for l in &d.summary { println!("    {l}"); } for w in &d.warnings { println!("    ! {w}"); } if let Some(u) = &d.unknown { println!("   veto {:?}", u.vetoes);} }
        if args.len() > 5 { for e in &d.effects { println!("     {} {:?} p {:?} surv {:?} {:?} {}", e.id, e.status, e.p_value, e.survival, e.parameters.first().map(|p| (p.value, p.sigma)), e.reason); } for f in &d.findings { println!("   {:?} {:?}", f.located_by, f.rivals); } println!("{:?}", d.located); }
    }
}
