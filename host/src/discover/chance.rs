//! Tail probabilities, as logarithms: what is found is often far beyond the smallest number that a computer holds.

use statrs::function::beta::{beta_reg, ln_beta};
use statrs::function::gamma::{gamma_ur, ln_gamma};

/// `ln P(χ²_k > x)`.
pub fn ln_chi_square(x: f64, k: usize) -> f64 {
    if k == 0 || x <= 0.0 {
        return 0.0;
    }
    let (a, z) = (0.5 * k as f64, 0.5 * x);
    if z < a + 20.0 {
        return gamma_ur(a, z).max(f64::MIN_POSITIVE).ln();
    }
    // Lentz's continued fraction of the upper incomplete gamma function.
    let mut b = z + 1.0 - a;
    let mut c = 1e300;
    let mut d = 1.0 / b;
    let mut h = d;
    for i in 1..200 {
        let i = f64::from(i);
        let an = -i * (i - a);
        b += 2.0;
        d = 1.0 / (an * d + b);
        c = b + an / c;
        let change = d * c;
        h *= change;
        if (change - 1.0).abs() < 1e-12 {
            break;
        }
    }
    -z + a * z.ln() - ln_gamma(a) + h.ln()
}

/// `ln P` of a drop of the sum of squares `x` by `k` columns where the noise was estimated from `n` numbers and the drop is
/// that of a likelihood ratio: Fisher's F in place of χ².
pub fn ln_likelihood_ratio(x: f64, k: usize, n: f64) -> f64 {
    if k == 0 || x <= 0.0 {
        return 0.0;
    }
    let left = n - k as f64;
    if !n.is_finite() || n > 2000.0 || left < 1.0 {
        return ln_chi_square(x, k);
    }
    // exp(x / n) - 1 = k F / (n - k); the tail of F is a beta function of n_left / (n_left + k F) = exp(-x / n).
    let (a, b) = (0.5 * left, 0.5 * k as f64);
    ln_beta_lower(a, b, (-x / n).exp())
}

/// Chances above this can be told as numbers.
const TELLABLE: f64 = 1e-250;

/// `ln I_z(a, b)`, the regularised incomplete beta function, accurate for small values.
fn ln_beta_lower(a: f64, b: f64, z: f64) -> f64 {
    if z >= 1.0 {
        return 0.0;
    }
    // The continued fraction needs few terms where the series below needs thousands.
    let chance = beta_reg(a, b, z);
    if chance > TELLABLE {
        return chance.ln();
    }
    let (mut term, mut sum) = (1.0, 1.0);
    for i in 0..20_000 {
        let i = f64::from(i);
        term *= (a + b + i) / (a + 1.0 + i) * z;
        sum += term;
        if term < 1e-14 * sum {
            break;
        }
    }
    (a * z.ln() + b * (-z).ln_1p() - a.ln() - ln_beta(a, b) + sum.ln()).min(0.0)
}

/// `ln(1 - (1 - p)^m)`: the chance that the smallest of `m` independent tail probabilities is as small as `exp(ln_p)`.
pub fn ln_smallest_of(ln_p: f64, m: f64) -> f64 {
    if ln_p >= 0.0 {
        return 0.0;
    }
    let none = m * (-ln_p.exp()).ln_1p();
    if none > -1e-12 { ln_p + m.ln() } else { (-none.exp_m1()).ln() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_agree_with_tables() {
        // R: pchisq(c(3.841459, 16.81189, 200), c(1, 6, 3), lower.tail = FALSE, log.p = TRUE)
        assert!((ln_chi_square(3.841_458_820_694_124, 1) - 0.05_f64.ln()).abs() < 1e-9);
        assert!((ln_chi_square(16.811_893_829_770_93, 6) - 0.01_f64.ln()).abs() < 1e-9);
        // Both branches meet: the tail at the switch of a χ² with 2 degrees is exp(-x / 2) exactly.
        for x in [41.9, 42.1, 400.0, 3000.0] {
            assert!((ln_chi_square(x, 2) + 0.5 * x).abs() < 1e-9 * x, "{x}");
        }
    }

    #[test]
    fn estimated_noise_widens_the_tail() {
        // A t of 10 degrees of freedom beyond 2.228139 on both sides is 5 %: F = t², x = n ln(1 + F / 10), n = 11.
        let f: f64 = 2.228_138_851_986_273_f64.powi(2);
        let x = 11.0 * (f / 10.0).ln_1p();
        assert!((ln_likelihood_ratio(x, 1, 11.0) - 0.05_f64.ln()).abs() < 1e-9);
        assert!(ln_likelihood_ratio(30.0, 2, 60.0) > ln_chi_square(30.0, 2));
        // Of two degrees the tail is a power, as a number and beyond what a number can be: exp(-x / n) to the n / 2 - 1.
        for (x, n) in [(3.0, 900.0), (200.0, 900.0), (1100.0, 900.0), (1300.0, 1900.0), (4000.0, 1900.0)] {
            let exact = -x / n * (0.5 * n - 1.0);
            assert!((ln_likelihood_ratio(x, 2, n) - exact).abs() < 1e-9 * exact.abs().max(1.0), "{x} of {n}");
        }
    }

    #[test]
    fn the_smallest_of_many() {
        assert!((ln_smallest_of(0.01_f64.ln(), 100.0) - (1.0 - 0.99_f64.powi(100)).ln()).abs() < 1e-12);
        assert!((ln_smallest_of(-200.0, 50.0) - (-200.0 + 50.0_f64.ln())).abs() < 1e-9);
    }
}
