//! Small dense systems of linear equations, of double precision.

/// The lower triangular factor of a covariance of `n` values, both row by row; `None` if it holds a value that is no finite number. Where a
/// value has no variance of its own, it gets a millionth of its variance.
pub(super) fn cholesky(a: &[f64], n: usize) -> Option<Vec<f64>> {
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let (own, other) = (&factor[n * i..][..j], &factor[n * j..][..j]);
            let rest = a[n * i + j] - own.iter().zip(other).map(|(a, b)| a * b).sum::<f64>();
            factor[n * i + j] = if i != j {
                rest / factor[n * j + j]
            } else if rest > 0.0 {
                rest.sqrt()
            } else {
                // A correlation that is too strong by rounding or by chance leaves next to nothing of its own.
                (1e-6 * a[n * i + i]).max(f64::MIN_POSITIVE).sqrt()
            };
        }
    }
    factor.iter().all(|v| v.is_finite()).then_some(factor)
}

/// The solution of A x = b for a covariance A, row by row; `None` if it is no finite number.
pub(super) fn solved(a: &[f64], b: Vec<f64>) -> Option<Vec<f64>> {
    let x = solved_by(&cholesky(a, b.len())?, b);
    x.iter().all(|v| v.is_finite()).then_some(x)
}

/// The solution of A x = b, given the factor of A by [`cholesky`].
pub(super) fn solved_by(factor: &[f64], b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    let mut x = b;
    for i in 0..n {
        let known = factor[n * i..][..i].iter().zip(&x).map(|(a, x)| a * x).sum::<f64>();
        x[i] = (x[i] - known) / factor[n * i + i];
    }
    for i in (0..n).rev() {
        let known = (i + 1..n).map(|k| factor[n * k + i] * x[k]).sum::<f64>();
        x[i] = (x[i] - known) / factor[n * i + i];
    }
    x
}
