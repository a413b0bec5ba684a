//! Cholesky's method for small symmetric matrices on the stack, of which a leading block may be in use.

/// Cholesky factor of the leading block, the diagonal raised by `damping`.
fn factor<const N: usize>(matrix: &[[f64; N]; N], count: usize, damping: f64) -> Option<[[f64; N]; N]> {
    let mut l = [[0.0; N]; N];
    for i in 0..count {
        for j in 0..=i {
            let raised = if i == j { matrix[i][i] * (1.0 + damping) } else { matrix[i][j] };
            let rest = raised - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i == j {
                if rest.is_nan() || rest <= 1e-13 * matrix[i][i] {
                    return None;
                }
                l[i][i] = rest.sqrt();
            } else {
                l[i][j] = rest / l[j][j];
            }
        }
    }
    Some(l)
}

/// Solves for the leading `count` unknowns, the diagonal raised by the share `damping`; of the matrix the lower triangle is read. `None` where it
/// is not positive definite, or the solution not finite.
pub(crate) fn solve<const N: usize>(matrix: &[[f64; N]; N], vector: &[f64; N], count: usize, damping: f64) -> Option<[f64; N]> {
    let l = factor(matrix, count, damping)?;
    let mut x = *vector;
    for i in 0..count {
        let known: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    for i in (0..count).rev() {
        let known: f64 = (i + 1..count).map(|k| l[k][i] * x[k]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    x[..count].iter().all(|v| v.is_finite()).then_some(x)
}

/// The inverse of the leading block, `None` as above.
pub(crate) fn inverse<const N: usize>(matrix: &[[f64; N]; N], count: usize) -> Option<[[f64; N]; N]> {
    let mut out = [[0.0; N]; N];
    for column in 0..count {
        let mut unit = [0.0; N];
        unit[column] = 1.0;
        let solved = solve(matrix, &unit, count, 0.0)?;
        for row in 0..count {
            out[row][column] = solved[row];
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the leading block alone, and of its lower triangle.
    const MATRIX: [[f64; 3]; 3] = [[4.0, f64::NAN, f64::NAN], [2.0, 5.0, f64::NAN], [f64::NAN, f64::NAN, f64::NAN]];

    #[test]
    fn the_leading_block_is_solved_and_inverted() {
        let x = solve(&MATRIX, &[10.0, 13.0, f64::NAN], 2, 0.0).unwrap();
        assert!((x[0] - 1.5).abs() < 1e-14 && (x[1] - 2.0).abs() < 1e-14, "{x:?}");
        let of = inverse(&MATRIX, 2).unwrap();
        for (i, row) in [[5.0, -2.0], [-2.0, 4.0]].iter().enumerate() {
            assert!((0..2).all(|j| (of[i][j] - row[j] / 16.0).abs() < 1e-15), "{of:?}");
        }
        // the diagonal raised by a half: 6 and 7.5
        let x = solve(&MATRIX, &[8.0, 9.5, 0.0], 2, 0.5).unwrap();
        assert!((x[0] - 1.0).abs() < 1e-14 && (x[1] - 1.0).abs() < 1e-14, "{x:?}");
    }

    #[test]
    fn what_is_not_positive_definite_has_no_solution() {
        for matrix in [[[1.0, 0.0], [2.0, 4.0]], [[-1.0, 0.0], [0.0, 1.0]], [[f64::NAN, 0.0], [0.0, 1.0]]] {
            assert_eq!(solve(&matrix, &[1.0, 1.0], 2, 0.0), None);
        }
        assert!(solve(&[[1.0, 0.0], [2.0, 4.0]], &[1.0, 1.0], 2, 0.1).is_some());
    }
}
