//! What `identify -o` and `detect -o` leave in their folder: each file says what the result says.

use boresight::coordinates::{Direction, Icrs, PixelPoint};
use boresight::exchange::import;
use boresight::recording::{Recording, load_image};
use boresight::units::DEG_RAD;

use crate::cli::{json, mirrored_night, run, text};
use crate::world::Header;

#[test]
fn files_beside_the_result_agree_with_it() {
    let folder = tempfile::tempdir().unwrap();
    // Mirrored images, since signs are most easily wrong there.
    let night = mirrored_night(folder.path());
    let out = folder.path().join("out");
    let result = json(&["identify", text(&night), "--json", "-o", text(&out), "--fits", "--physics", "none"]);
    let recording = Recording::open(&[&night]).unwrap();
    let mut table = csv::Reader::from_path(out.join("matches.csv")).unwrap();
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    let mut row = 0;
    for (index, frame) in result["frames"].as_array().unwrap().iter().enumerate() {
        let stem = format!("{index:04}-{}", recording.frame_path(index).unwrap().file_stem().unwrap().to_string_lossy());
        let file = |ending: &str| out.join(format!("{stem}.{ending}"));
        let header = std::fs::read(file("wcs")).unwrap();
        let sky = import("wcs", &header, None, None).unwrap();
        let attitude = sky.camera_from_icrs.unwrap();
        let regions = std::fs::read_to_string(file("reg")).unwrap();
        let matches = frame["matches"].as_array().unwrap();
        assert!(matches.len() > 10 && frame["parity"] == -1);
        for star in matches {
            let cells = &rows[row];
            row += 1;
            let cell = |number: usize| cells[number].parse::<f64>().unwrap();
            let json = |key: &str| star[key].as_f64().unwrap();
            assert_eq!((cell(0), cell(3)), (index as f64, json("hip")));
            let (x_px, y_px) = (json("x_px"), json("y_px"));
            assert_eq!((cell(10), cell(11)), (x_px, y_px));
            assert_eq!(cell(7), 1991.25, "without proper motion a place is that of the catalogue's epoch");
            // The world coordinates put the star where it was measured, less the residual of the match, which is told in un-mirrored columns.
            let direction = Direction::<Icrs>::from_radec_rad(cell(5) * DEG_RAD, cell(6) * DEG_RAD);
            let in_camera = attitude.camera_from_apparent(&Direction::from_unit(direction.xyz));
            // A mirrored camera's model, in stored columns, has directions with x turned.
            let in_camera = Direction::from_unit([f64::from(sky.parity) * in_camera.xyz[0], in_camera.xyz[1], in_camera.xyz[2]]);
            let place = sky.model.pixel(&in_camera, &sky.model.reference_context()).unwrap();
            let PixelPoint { x_px: star_x_px, y_px: star_y_px } = place;
            let residual = [0, 1].map(|axis| star["residual_px"][axis].as_f64().unwrap());
            let off = [x_px - star_x_px + residual[0], y_px - star_y_px - residual[1]];
            assert!(off[0].abs() < 0.01 && off[1].abs() < 0.01, "HIP {}: {off:?}", star["hip"]);
            assert!(regions.contains(&format!("circle({:.4},{:.4},", x_px + 1.0, y_px + 1.0)), "{regions}");
        }
        // The image is the frame, with the same header.
        let image = load_image(&file("fits")).unwrap();
        assert_eq!(image.pixels_dn, recording.load_frame(index).unwrap().pixels_dn);
        let of_image = import("fits", &std::fs::read(file("fits")).unwrap(), None, None).unwrap();
        assert_eq!((of_image.camera_from_icrs, of_image.parity), (sky.camera_from_icrs, sky.parity));
        assert!(image::open(file("png")).unwrap().width() > 500);
    }
    assert_eq!(row, rows.len());
    // The same with all that is done to the light on its way: a star's place at the frame's epoch, as the table has it, leads through the header to
    // where the model has its image.
    let known = folder.path().join("known");
    let result = json(&["identify", text(&night), "--json", "-o", text(&known)]);
    let mut table = csv::Reader::from_path(known.join("matches.csv")).unwrap();
    for (row, star) in table
        .records()
        .map(Result::unwrap)
        .zip(result["frames"].as_array().unwrap().iter().flat_map(|frame| frame["matches"].as_array().unwrap()))
    {
        let cell = |number: usize| row[number].parse::<f64>().unwrap();
        let stem = recording.frame_path(cell(0) as usize).unwrap().file_stem().unwrap().to_string_lossy().into_owned();
        let header = Header::read(&std::fs::read(known.join(format!("{:04}-{stem}.wcs", cell(0)))).unwrap());
        let [x_px, y_px] = header.pixel([cell(5), cell(6)]);
        assert!((cell(7) - 2026.16).abs() < 0.02, "the night is of the first of March of 2026: {}", cell(7));
        // Residuals are told in un-mirrored columns.
        let off = [cell(10) + cell(12) - x_px, cell(11) - cell(13) - y_px];
        assert!(off[0].hypot(off[1]) < 0.01, "HIP {}: {off:?}", star["hip"]);
    }
    assert!(std::fs::read(out.join("matches.parquet")).unwrap().starts_with(b"PAR1"));
    let detections = std::fs::read_to_string(out.join("detections.csv")).unwrap();
    let detected: u64 = result["frames"].as_array().unwrap().iter().map(|frame| frame["stars_detected"].as_u64().unwrap()).sum();
    assert_eq!(detections.lines().count() as u64, detected + 1);

    let measured = folder.path().join("measured");
    assert_eq!(run(&["detect", text(&night), "-o", text(&measured)]).code, 0);
    assert_eq!(std::fs::read_to_string(measured.join("detections.csv")).unwrap(), detections);
    assert!(run(&["identify", text(&night), "--fits"]).stderr.contains("--output"));
}
