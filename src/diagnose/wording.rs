//! Text of a diagnosis: its verdicts, findings and summary in sentences.

use super::channels::{ChannelVerdict, Detectable};
use super::diagnosis::{ColumnSource, Diagnosis, EffectState, Finding, FoundParameter};
use super::resolved::{least_p, told};
use super::value_with_error::with_error;
use crate::effects::AnyDisplacement;

fn quantity(parameter: &FoundParameter) -> String {
    let space = if parameter.unit.is_empty() { "" } else { " " };
    format!("{} = {}{space}{}", parameter.name, parameter.value_and_error(), parameter.unit)
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
        ColumnSource::Rendered => " The model column was rendered from this recording's stars.",
        ColumnSource::Formula => "",
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

/// The remark of an effect that the turns have sized and not chosen.
pub(super) const SIZED_ALONE: &str = "chosen by all frames, sized in every turn";

/// How the remark of an extinction begins that the zero points of the frames confirm and no turn can.
pub(super) const BY_ZERO_POINTS: &str = "confirmed by the zero points of the frames";

/// A finding of brightness and shape in one or two sentences.
pub(super) fn image_finding(finding: &Finding) -> String {
    let sizes: Vec<String> = finding.parameters.iter().map(quantity).collect();
    let decided: Vec<String> = finding
        .channels
        .iter()
        .filter_map(|(channel, own)| Some(format!("{} Δχ² {:.0}", channel.words(), own.as_ref()?.delta_chi2)))
        .collect();
    let [times, turns] = finding.chosen_again;
    let per_dof: Vec<String> = finding
        .channels
        .iter()
        .filter_map(|(channel, own)| {
            let [before, after] = (*own)?.held_out_chi2_per_dof?;
            Some(format!("{} {before:.2} → {after:.2}", channel.words()))
        })
        .collect();
    let per_dof = if per_dof.is_empty() { String::new() } else { format!(" (per degree of freedom: {})", per_dof.join(", ")) };
    // A fall that rounds to nothing is printed without a sign.
    let fall = finding.held_out_delta_chi2.round() + 0.0;
    let (left_out, remark) = (&finding.left_out, finding.held_out_remark.as_deref());
    let held_out = if let Some(remark) = remark.filter(|remark| remark.starts_with(BY_ZERO_POINTS)) {
        format!("Turns that leave {left_out} out cannot test it: χ² falls by {fall:.0} there. It is {remark}")
    } else {
        let chosen = if remark == Some(SIZED_ALONE) { "Chosen by all frames and" } else { "Chosen and" };
        format!(
            "{chosen} sized anew in turns that leave {left_out} out (chosen again in {times} of {turns}) it lowers χ² there by {fall:.0}{per_dof}"
        )
    };
    format!(
        "{} was left out: {}. Modelling it lowers χ² by {:.0} ({}). {held_out}.",
        finding.id,
        sizes.join(", "),
        finding.delta_chi2,
        decided.join(", ")
    )
}

/// What a channel's verdict rests on.
pub(super) fn reason(verdict: ChannelVerdict, largest: &str, detectable: &[Detectable]) -> String {
    let seen = detectable.iter().filter(|own| own.would_show).count();
    let power = format!("of {} effects of ordinary size {seen} would have shown", detectable.len());
    match verdict {
        ChannelVerdict::NotLookedAt => String::new(),
        ChannelVerdict::Undecided => format!("nothing shows, and {power}"),
        ChannelVerdict::Consistent => format!("nothing shows; {power}"),
        ChannelVerdict::Explained | ChannelVerdict::Unexplained if largest.is_empty() => power,
        ChannelVerdict::Explained | ChannelVerdict::Unexplained => format!("{largest} stands out most; {power}"),
    }
}

/// A number in a sentence.
fn plain(number: f64) -> String {
    let digits = (1.0 - number.abs().max(f64::MIN_POSITIVE).log10().floor()).max(0.0) as usize;
    if (1e-3..1e5).contains(&number.abs()) { format!("{number:.digits$}") } else { format!("{number:.1e}") }
}

/// Effects named where nothing could have shown.
const NEAREST: usize = 3;

/// How large the effects that show best would have had to be.
fn would_have_to_be(detectable: &[Detectable]) -> String {
    let sizes: Vec<String> = detectable
        .iter()
        .filter_map(|own| Some((own, own.size_95?)))
        .take(NEAREST)
        .map(|(own, size)| format!("{} of {} {} (ordinary: {})", own.id, own.name, plain(size), plain(own.ordinary)))
        .collect();
    if sizes.is_empty() {
        "attitudes and camera take up all effects".to_owned()
    } else {
        format!("what could have been seen is {}", sizes.join(", "))
    }
}

/// The summary.
pub(super) fn summary(diagnosis: &Diagnosis, left_p: f64) -> Vec<String> {
    let mut lines = Vec::new();
    let least = least_p(diagnosis.nulls);
    let places = &diagnosis.channels.astrometry;
    let p = told(places.p_value.unwrap_or(1.0), least);
    // First of what is spoken at all.
    lines.push(diagnosis.channels.in_words());
    lines.push(match places.verdict {
        ChannelVerdict::Consistent if diagnosis.scope.len() > 1 => format!("The star positions are as the model has them ({p})."),
        ChannelVerdict::Consistent => format!("The star positions are as the model has them ({p}); of anything else nothing is said."),
        ChannelVerdict::Explained => format!(
            "In the star positions something was missing ({p}), and is explained by what follows; nothing more shows in them ({}).",
            told(left_p, least)
        ),
        ChannelVerdict::Unexplained => {
            format!("In the star positions something is missing ({p}) that the effects of the registry do not explain in full.")
        }
        ChannelVerdict::Undecided | ChannelVerdict::NotLookedAt => format!(
            "The star positions show nothing ({p}), and no effect of ordinary size could have shown in them; {}.",
            would_have_to_be(&places.detectable)
        ),
    });
    lines.extend(diagnosis.findings.iter().map(|finding| finding.sentence.clone()));
    lines.extend(diagnosis.unknown.iter().map(|unknown| unknown.sentence.clone()));
    let (before, after) = (&diagnosis.fit.baseline, &diagnosis.fit.after);
    if !diagnosis.findings.is_empty() {
        let held = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"));
        lines.push(format!(
            "Residuals of the positions fall from {:.4} to {:.4} px rms, on held-out frames from {} to {} px.",
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
        lines.push(format!("Not judged, for the reasons that stand with each: {}.", lacking.join(", ")));
    }
    lines
}
