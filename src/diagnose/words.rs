//! The diagnosis in plain sentences.

use super::diagnosis::{ColumnsOf, Diagnosis, EffectState, Finding, FoundParameter, Verdict};
use crate::effects::AnyDisplacement;

/// A number with its error, as many digits as the error bears.
pub(super) fn with_error(value: f64, sigma: f64) -> String {
    if !(sigma > 0.0 && sigma.is_finite()) {
        return format!("{value:.4}");
    }
    let digits = 1 - sigma.log10().floor() as i32;
    if (0..=6).contains(&digits) {
        let digits = usize::try_from(digits).unwrap_or(0);
        format!("{value:.digits$} ± {sigma:.digits$}")
    } else if digits < 0 && digits > -5 {
        format!("{value:.0} ± {sigma:.0}")
    } else {
        let exponent = sigma.log10().floor() as i32;
        let unit = 10.0_f64.powi(exponent);
        format!("({:.1} ± {:.1})e{exponent}", value / unit, sigma / unit)
    }
}

fn quantity(parameter: &FoundParameter) -> String {
    let space = if parameter.unit.is_empty() { "" } else { " " };
    format!("{} = {}{space}{}", parameter.name, with_error(parameter.value, parameter.sigma), parameter.unit)
}

/// The title of an effect's page, in the middle of a sentence.
pub(super) fn title(effect: &dyn AnyDisplacement) -> String {
    let page = effect.page();
    let line = page.lines().next().unwrap_or_default().trim_start_matches('#').trim().to_owned();
    if line.is_empty() { effect.id().to_owned() } else { line }
}

/// A finding in one or two sentences.
pub(super) fn finding(finding: &Finding, effect: &dyn AnyDisplacement, in_force: bool) -> String {
    let sizes: Vec<String> = finding.parameters.iter().map(quantity).collect();
    let located = finding.located_by.first().map_or_else(String::new, |name| format!("Star images are displaced in step with {name}. "));
    let what = if in_force {
        format!("{} is in the model at another size than in the recording", title(effect))
    } else {
        format!("{} was left out", title(effect))
    };
    let known = finding.known_amplitude.map_or_else(String::new, |[ratio, error]| {
        format!(", {} of the size that the recording's own data give", with_error(ratio, error))
    });
    let rendered = match finding.columns {
        ColumnsOf::Rendered => " Its trace is that of the recording's own stars, rendered with it and measured.",
        ColumnsOf::Formula => "",
    };
    let [times, turns] = finding.chosen_again;
    let held = format!(
        "Chosen and sized anew in turns that leave {} out (chosen again in {times} of {turns}) it lowers χ² there by {:.0}, {:.0} expected{}.",
        finding.left_out,
        finding.held_out_delta_chi2,
        finding.held_out_expected,
        finding.held_out_remark.as_ref().map_or_else(String::new, |remark| format!(": {remark}"))
    );
    let set = if finding.indistinguishable_from.is_empty() {
        String::new()
    } else {
        format!(" It cannot be told from {} here; what would decide: {}.", finding.indistinguishable_from.join(", "), finding.decided_by)
    };
    format!("{located}{what}: {}{known}. Modelling it lowers χ² by {:.0}. {held}{rendered}{set}", sizes.join(", "), finding.delta_chi2)
}

/// A probability: two decimals, or as a power of ten where these say nothing.
fn probability(p: f64) -> String {
    if p >= 0.01 { format!("{p:.2}") } else { format!("{p:.1e}") }
}

/// The summary.
pub(super) fn summary(diagnosis: &Diagnosis, left_p: f64) -> Vec<String> {
    let mut lines = Vec::new();
    let p = diagnosis.channels.astrometry.as_ref().map_or(1.0, |test| test.p_value);
    lines.push(match diagnosis.verdict {
        Verdict::Consistent => format!("Nothing is missing: the star positions are as the model has them (p = {}).", probability(p)),
        Verdict::Explained => {
            format!("Something was missing (p = {p:.1e}), and is explained by what follows; nothing is left (p = {}).", probability(left_p))
        }
        Verdict::Unexplained => format!("Something is missing (p = {p:.1e}) that the effects of the registry do not explain in full."),
    });
    lines.extend(diagnosis.findings.iter().map(|finding| finding.sentence.clone()));
    lines.extend(diagnosis.unknown.iter().map(|unknown| unknown.sentence.clone()));
    let (before, after) = (&diagnosis.fit.baseline, &diagnosis.fit.after);
    if !diagnosis.findings.is_empty() {
        let held = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"));
        lines.push(format!(
            "Residuals fall from {:.4} to {:.4} px rms, on held-out frames from {} to {} px.",
            before.rms_px,
            after.rms_px,
            held(before.held_out_rms_px),
            held(after.held_out_rms_px)
        ));
    }
    let of = |state: EffectState| -> Vec<&str> {
        diagnosis.effects.iter().filter(|effect| effect.status == state).map(|effect| effect.id.as_str()).collect()
    };
    let (hidden, lacking) = (of(EffectState::NotObservable), of(EffectState::NotApplicable));
    if !hidden.is_empty() {
        lines.push(format!("This recording could not show: {}.", hidden.join(", ")));
    }
    if !lacking.is_empty() {
        lines.push(format!("Not judged, because the recording lacks what they need: {}.", lacking.join(", ")));
    }
    lines
}
