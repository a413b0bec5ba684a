//! Answers in every form, with what can be wrong with them.

use super::*;
use crate::suite::conventions::WrittenAttitude;
use crate::suite::suite_file::AnswerForm;

fn faults(form: AnswerForm, text: &str) -> Vec<String> {
    read_answers(form, text.as_bytes(), [100, 80]).faults
}

#[test]
fn tables_are_read_and_their_faults_named() {
    let good = "frame,status,qi,qj,qk,qw,time_s,error\n0,solved,0,0,0,1,0.02,\n1,none,,,,,,\n2,error,,,,,,no light\n";
    let file = read_answers(AnswerForm::Csv, good.as_bytes(), [100, 80]);
    assert_eq!(file.faults, Vec::<String>::new());
    assert_eq!(file.answers[0].1.attitude, Some(WrittenAttitude::Quaternion([0.0, 0.0, 0.0, 1.0])));
    assert_eq!(file.answers[2].1.error.as_deref(), Some("no light"));
    let pointing = "status,ra_deg,dec_deg,roll_deg\nsolved,10,20,30\n";
    assert_eq!(
        read_answers(AnswerForm::Csv, pointing.as_bytes(), [1, 1]).of_frame(7).attitude,
        Some(WrittenAttitude::RaDecRoll([10.0, 20.0, 30.0]))
    );
    for (text, named) in [
        ("frame,status,qi,qj,qk,qw\n0,solved,0,0,0\n", "line 2"),
        ("frame,status,qi,qj,qk,qw\n0,solved,0,0,0,2\n", "line 2: the quaternion has the length 2.0000"),
        ("frame,status,qi,qj,qk,qw\n0,sloved,0,0,0,1\n", "line 2: status = \"sloved\"; write solved, none or error"),
        ("frame,status,qi,qj,qk,qw\n0,solved,,,,\n", "line 2: status is solved, and the attitude is missing"),
        ("frame,status,qi,qj,qk,qw\n0,solved,0,zero,0,1\n", "line 2: qj = \"zero\" is no number"),
        ("frame,statsu,qi,qj,qk,qw\n", "line 1: there is no column statsu; did you mean status?"),
        ("frame,status,qi,qj,qk\n", "line 1: there is neither a quaternion"),
        ("frame,status,qi,qj,qk,qw\n1,none,,,,\n1,none,,,,\n", "the frame 1 is answered twice"),
        ("\u{1b}[0mSegmentation fault\n", "line 1"),
    ] {
        let all = faults(AnswerForm::Csv, text);
        assert!(all.iter().any(|fault| fault.starts_with(named)), "{text:?}: {all:?}");
    }
}

#[test]
fn json_is_read_as_object_list_and_lines() {
    let one = r#"{"frame": 3, "status": "solved", "quaternion": [0, 0, 0, 1], "centroids": [[1, 2], [3, 4, 5, 6]], "camera": {"focal_length_px": 7}}"#;
    for text in [one.to_owned(), format!("[{one}]"), format!("{one}\n{}\n", one.replace('3', "4"))] {
        let file = read_answers(AnswerForm::Json, text.as_bytes(), [1, 1]);
        assert_eq!(file.faults, Vec::<String>::new(), "{text}");
        let (frame, answer) = &file.answers[0];
        assert_eq!((*frame, answer.centroids.as_ref().map(Vec::len)), (Some(3), Some(2)));
        assert_eq!(answer.centroids.as_ref().unwrap()[1].hip, Some(6));
    }
    for (text, named) in [
        ("", "is empty"),
        ("{\"status\": \"solved\"}", "status is solved, and there is neither"),
        ("{\"staus\": \"none\"}", "line 1, column 8: unknown key staus; did you mean status?"),
        ("{\"status\": \"none\"", "line 1, column 17: EOF"),
        ("{\"status\": \"solved\", \"matrix\": [[1,0,0],[0,1,0],[0,1,0]]}", "the matrix is no rotation"),
    ] {
        let all = faults(AnswerForm::Json, text);
        assert!(all.iter().any(|fault| fault.starts_with(named)), "{text:?}: {all:?}");
    }
}

/// The text that LOST itself wrote for a frame of its generator, and the dictionary of tetra3.
#[test]
fn lost_and_tetra3_are_read_as_they_write() {
    let lost = "attitude_known 1\nattitude_ra 88.0\nattitude_de 7.0\nattitude_roll 0\nattitude_i -0.042408\nattitude_j 0.043915\nattitude_k -0.693363\nattitude_real 0.717998\n";
    let answer = read_answers(AnswerForm::Lost, lost.as_bytes(), [1, 1]).of_frame(0);
    assert_eq!(answer.status, AnswerStatus::Solved);
    let attitude = usual_conventions(AnswerForm::Lost).read(&answer.attitude.unwrap()).unwrap();
    let [ra, dec, roll] = attitude.pointing_rad().map(f64::to_degrees);
    assert!((ra - 88.0).abs() < 0.02 && (dec - 7.0).abs() < 0.02 && roll.abs() < 0.05, "{ra} {dec} {roll}");
    assert_eq!(read_answers(AnswerForm::Lost, b"attitude_known 0\n", [1, 1]).of_frame(0).status, AnswerStatus::None);
    assert!(faults(AnswerForm::Lost, "num_centroids 3\n")[0].starts_with("there is no line attitude_known"));
    let tetra3 = r#"{"RA": 10.0, "Dec": -20.0, "Roll": 350.0, "FOV": 11.4, "T_solve": 3.0, "T_extract": 2.0}"#;
    let answer = read_answers(AnswerForm::Tetra3, tetra3.as_bytes(), [1, 1]).of_frame(0);
    assert_eq!((answer.attitude, answer.time_s), (Some(WrittenAttitude::RaDecRoll([10.0, -20.0, -350.0])), Some(0.005)));
    assert_eq!(
        read_answers(AnswerForm::Tetra3, br#"{"RA": null, "Dec": null, "Roll": null}"#, [1, 1]).of_frame(0).status,
        AnswerStatus::None
    );
}
