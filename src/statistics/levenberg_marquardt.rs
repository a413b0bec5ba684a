//! Levenberg and Marquardt's method: least squares by damped linear steps.
//!
//! Here is how a step is tried, taken or taken back, and how the damping follows; what is linearised, how it is solved and when a step is small
//! enough, the problem knows. Nothing is allocated here. Source: Marquardt, J. Soc. Indust. Appl. Math. 11, 431 (1963).

/// A sum of squares that steps make less. It stands somewhere, and moves.
pub(crate) trait LeastSquares {
    /// A step.
    type Step;

    /// Linearises where the problem stands.
    fn linearise(&mut self);

    /// The step of the linear problem under a damping; `None` where that has no solution.
    fn step(&self, damping: f64) -> Option<Self::Step>;

    /// Takes the step if that makes the sum less.
    fn attempt(&mut self, step: &Self::Step) -> Attempt;
}

/// What came of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Attempt {
    /// Whether the sum is less, and the step taken.
    pub(crate) is_better: bool,
    /// Whether the step was so small, or won so little, that it is the last.
    pub(crate) is_last: bool,
}

/// How the damping goes, and what ends the search besides a small step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    /// The damping of the first step.
    pub(crate) first_damping: f64,
    /// The damping after a step that was taken.
    pub(crate) smaller: fn(f64) -> f64,
    /// The damping after a step that was not.
    pub(crate) larger: fn(f64) -> f64,
    /// There is no way down where only a damping above this would be left,
    pub(crate) most_damping: f64,
    /// or after so many steps in a row that were not taken.
    pub(crate) most_rejected: usize,
    /// The most linearisations.
    pub(crate) linearisations: usize,
    /// The most steps, taken or not.
    pub(crate) steps: usize,
    /// Whether a linear problem without a solution is the end; else it is damped more.
    pub(crate) ends_without_step: bool,
}

/// How the search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// With a last step.
    Settled,
    /// No step makes the sum less.
    Stuck,
    /// The linear problem has no solution.
    Singular,
    /// After the most linearisations or steps.
    Exhausted,
}

/// Goes down from where the problem stands. It stands at the least sum that was found.
pub(crate) fn minimise<P: LeastSquares>(problem: &mut P, rules: &Rules) -> End {
    let (mut damping, mut steps) = (rules.first_damping, 0);
    for _ in 0..rules.linearisations {
        problem.linearise();
        let mut rejected = 0;
        loop {
            if steps == rules.steps {
                return End::Exhausted;
            }
            steps += 1;
            let attempt = match problem.step(damping) {
                Some(step) => problem.attempt(&step),
                None if rules.ends_without_step => return End::Singular,
                None => Attempt { is_better: false, is_last: false },
            };
            if attempt.is_better {
                damping = (rules.smaller)(damping);
            }
            if attempt.is_last {
                return End::Settled;
            }
            if attempt.is_better {
                break;
            }
            damping = (rules.larger)(damping);
            if rejected == rules.most_rejected || damping > rules.most_damping {
                return End::Stuck;
            }
            rejected += 1;
        }
    }
    End::Exhausted
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::cholesky::solve;

    const RULES: Rules = Rules {
        first_damping: 0.0,
        smaller: |damping| if damping < 1e-4 { 0.0 } else { damping / 10.0 },
        larger: |damping| (damping * 10.0).max(1e-3),
        most_damping: 1e8,
        most_rejected: usize::MAX,
        linearisations: 100,
        steps: usize::MAX,
        ends_without_step: false,
    };

    /// Two unknowns; residuals and their derivatives.
    struct Two<F> {
        at: [f64; 2],
        of: F,
        matrix: [[f64; 2]; 2],
        vector: [f64; 2],
        linearised: usize,
    }

    type Rows<const N: usize> = [(f64, [f64; 2]); N];

    impl<F: Fn([f64; 2]) -> Rows<N>, const N: usize> Two<F> {
        fn new(at: [f64; 2], of: F) -> Self {
            Self { at, of, matrix: [[0.0; 2]; 2], vector: [0.0; 2], linearised: 0 }
        }

        fn cost(&self, at: [f64; 2]) -> f64 {
            (self.of)(at).iter().map(|(residual, _)| residual * residual).sum()
        }
    }

    impl<F: Fn([f64; 2]) -> Rows<N>, const N: usize> LeastSquares for Two<F> {
        type Step = [f64; 2];

        fn linearise(&mut self) {
            (self.matrix, self.vector) = ([[0.0; 2]; 2], [0.0; 2]);
            self.linearised += 1;
            for (residual, row) in (self.of)(self.at) {
                for a in 0..2 {
                    self.vector[a] -= row[a] * residual;
                    for b in 0..=a {
                        self.matrix[a][b] += row[a] * row[b];
                    }
                }
            }
        }

        fn step(&self, damping: f64) -> Option<[f64; 2]> {
            solve(&self.matrix, &self.vector, 2, damping)
        }

        fn attempt(&mut self, step: &[f64; 2]) -> Attempt {
            let next = [self.at[0] + step[0], self.at[1] + step[1]];
            let is_better = self.cost(next) <= self.cost(self.at);
            if is_better {
                self.at = next;
            }
            Attempt { is_better, is_last: step[0].hypot(step[1]) < 1e-10 }
        }
    }

    fn rosenbrock([x, y]: [f64; 2]) -> Rows<2> {
        [(10.0 * (y - x * x), [-20.0 * x, 10.0]), (1.0 - x, [-1.0, 0.0])]
    }

    /// x + 2y = 4 and twice the same.
    fn deficient([x, y]: [f64; 2]) -> Rows<2> {
        [(x + 2.0 * y - 4.0, [1.0, 2.0]), (2.0 * x + 4.0 * y - 8.0, [2.0, 4.0])]
    }

    #[test]
    fn the_bent_valley_is_followed_to_its_end() {
        let mut problem = Two::new([-1.2, 1.0], rosenbrock);
        assert_eq!(minimise(&mut problem, &RULES), End::Settled);
        assert!((problem.at[0] - 1.0).abs() < 1e-9 && (problem.at[1] - 1.0).abs() < 1e-9, "{:?}", problem.at);
        // too few linearisations, or steps, and it is said
        for rules in [Rules { linearisations: 3, ..RULES }, Rules { steps: 3, ..RULES }] {
            let mut problem = Two::new([-1.2, 1.0], rosenbrock);
            assert_eq!(minimise(&mut problem, &rules), End::Exhausted);
            assert!(problem.cost(problem.at) > 1e-3, "{:?}", problem.at);
        }
    }

    #[test]
    fn a_linear_problem_takes_one_step() {
        let line = |[a, b]: [f64; 2]| [(0.0, 1.0), (1.0, 3.0), (2.0, 5.5)].map(|(x, y)| (a + b * x - y, [1.0, x]));
        let mut problem = Two::new([40.0, -7.0], line);
        assert_eq!(minimise(&mut problem, &RULES), End::Settled);
        // the second linearisation finds nothing left
        assert!(problem.linearised <= 2, "{}", problem.linearised);
        assert!((problem.at[0] - 2.75 / 3.0).abs() < 1e-9 && (problem.at[1] - 2.25).abs() < 1e-9, "{:?}", problem.at);
    }

    #[test]
    fn what_is_open_is_damped_or_said() {
        let mut problem = Two::new([0.0, 0.0], deficient);
        assert_eq!(minimise(&mut problem, &RULES), End::Settled);
        assert!(problem.cost(problem.at) < 1e-18, "{:?}", problem.at);
        let mut problem = Two::new([0.0, 0.0], deficient);
        assert_eq!(minimise(&mut problem, &Rules { ends_without_step: true, ..RULES }), End::Singular);
        assert_eq!(problem.at, [0.0, 0.0]);
    }

    #[test]
    fn where_nothing_is_less_it_is_stuck() {
        // Derivatives of the wrong sign: every step leads up.
        let wrong = |[x, y]: [f64; 2]| [(x - 3.0, [-1.0, 0.0]), (y - 3.0, [0.0, -1.0])];
        for rules in [RULES, Rules { most_damping: f64::INFINITY, most_rejected: 14, ..RULES }] {
            let mut problem = Two::new([0.0, 0.0], wrong);
            assert_eq!(minimise(&mut problem, &rules), End::Stuck);
            assert_eq!(problem.at, [0.0, 0.0]);
        }
    }
}
