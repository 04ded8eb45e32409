//! Footage of one camera made to look like that of another.

use crate::{
    Result,
    composite::{DepthMaps, Missing, Rendered, in_metres},
    estimate::of_frame,
    footage::changed,
    frames::{DEPTH, FLOW, FRAME, Made, Neighbours, Sink, check_memory, for_each_frame},
    observer::{Observer, warn},
};
use blindaug::{
    CameraModel, Frame,
    composite::CompositeOptions,
    matching::{Matching, TooBlurred},
    model::{CameraTrack, DepthKind, Distortion, Estimate, Reason, SceneScale},
};

/// Bytes per pixel of the work on a frame.
const WORK: u64 = 300;

/// The matching of footage to another camera, with the depth and the lenses in one unit.
pub struct Match {
    footage: Rendered,
    depth: Option<DepthMaps>,
    from: CameraTrack,
    to: CameraModel,
    /// Whether motion blur is added.
    moving: bool,
}

/// Prepares footage of the camera `from`, which messages call `name`, to be made to look like that of the camera `to`. Both models must be
/// scaled to the footage; `scale` relates what is relative of its depth and of `from` to metres. The observer is told what cannot be
/// matched.
///
/// # Errors
/// If depth or `from` is relative and there is no scale, or memory does not suffice.
pub fn matching(
    mut footage: Rendered,
    (mut from, name): (CameraTrack, &str),
    mut to: CameraModel,
    scale: Option<SceneScale>,
    observer: &dyn Observer,
) -> Result<Match> {
    let relative = |m: &CameraModel| m.defocus.known().is_some_and(|l| l.depth_kind == DepthKind::Relative);
    let mut unmatched = None;
    let lens_known = [from.why_unknown(Distortion::Defocus), to.why_unknown(Distortion::Defocus)];
    if lens_known.iter().any(|why| why.is_some()) {
        // It was said already that a lens is unknown.
        unmatched = Some(None);
    } else if relative(&to) {
        unmatched = Some(Some(
            "the lens to be matched is over relative inverse depth, which means nothing in another scene: defocus stays as it is",
        ));
    } else if footage.depth.is_none() {
        unmatched = Some(Some("without depth defocus stays as it is"));
    }
    if let Some(sentence) = unmatched {
        sentence.into_iter().for_each(|s| observer.warning(s));
        let without = |mut m: CameraModel| {
            m.defocus = Estimate::unknown(Reason::NoDepth, "not matched");
            m
        };
        (from, to, footage.depth) = (from.map(without), without(to), None);
    }
    let from = in_metres(from, name, scale)?;
    let depth =
        footage.depth.take().map(|(maps, kind)| DepthMaps::in_metres(maps, kind, scale)).transpose()?;
    let clip = &*footage.clip;
    tell_excess(&from.at(0), &to, observer);
    let exposure = |m: &CameraModel| m.motion_blur.known().map_or(f32::NAN, |m| m.exposure.0);
    let moving = from.frames().iter().any(|f| exposure(&f.camera) < exposure(&to));
    let finds_flow = moving && footage.flow.is_none() && clip.len_hint() != Some(1);
    let given = if finds_flow { 3 * FRAME } else { FRAME } + if moving { FLOW } else { 0 };
    let work = WORK * (clip.size().0 * clip.size().1) as u64;
    check_memory(clip, given + if depth.is_some() { DEPTH } else { 0 }, finds_flow, work)?;
    Ok(Match { footage, depth, from, to, moving })
}

/// Says of which distortions the footage has more than the other camera, as nothing is taken away.
fn tell_excess(from: &CameraModel, to: &CameraModel, observer: &dyn Observer) {
    if let (Some(from), Some(to)) = (from.motion_blur.known(), to.motion_blur.known())
        && from.exposure.0 > to.exposure.0
    {
        let [from, to] = [from, to].map(|m| m.exposure.0);
        observer.note(&format!(
            "the footage has the longer exposure, {from:.2} of the frame interval for {to:.2}: its streaks stay, {:.2} of the motion too long",
            from - to
        ));
    }
    if let (Some(from), Some(to)) = (from.noise.known(), to.noise.known()) {
        let [from, to] = [from, to].map(|m| m.total_std(0.5).map(|v| 255.0 * v));
        if (0..3).any(|c| from[c] > to[c]) {
            let [[r, g, b], [p, q, s]] = [from, to];
            observer.note(&format!(
                "the footage is noisier in places: std {r:.1} {g:.1} {b:.1} of 255 in R, G and B at mid-grey for {p:.1} {q:.1} {s:.1}; where it is, its noise stays"
            ));
        }
    }
    let sharpening = |m: &CameraModel| m.sharpening.known().map_or(0.0, |s| s.amount);
    if (sharpening(from) - sharpening(to)).abs() > 0.1 {
        observer.note(&format!(
            "the footage is sharpened by an amount of {:.1}, the other camera's by {:.1}: sharpening is not matched",
            sharpening(from),
            sharpening(to)
        ));
    }
}

impl Match {
    /// Makes every frame that the sink does not have yet.
    ///
    /// # Errors
    /// If a frame or its accompanying data cannot be used, or the sink fails.
    pub fn run(
        &self,
        options: &CompositeOptions,
        sink: &mut dyn Sink,
        observer: &dyn Observer,
    ) -> Result<Made> {
        let Self { footage, depth, from, to, moving } = self;
        let clip = &*footage.clip;
        let neighbours = *moving && footage.flow.is_none();
        let (mut missing, mut said) = (Missing::new(observer), false);
        let seed = (!options.no_noise).then_some(options.seed);
        let beside = |n: u64| {
            let depth = depth.as_ref().and_then(|maps| maps.changed(n));
            depth.into_iter().chain(changed(footage.flow.as_ref(), n)).collect()
        };
        let make = |frame: &Frame, neighbours: &Neighbours, sink: &mut dyn Sink| {
            let (number, size) = (frame.number, clip.size());
            let of_frame = |e| of_frame(clip, number, e);
            let matching = Matching::new(&from.at(number), to, size.0, options.bokeh).map_err(of_frame)?;
            let flow = match &footage.flow {
                _ if !matching.moves() => None,
                Some(flow) => flow.get(number, size)?,
                None => neighbours.flow(frame)?,
            };
            missing.check(matching.moves() && flow.is_none(), number, "no flow", "it gets no motion blur");
            let inverse_depth = match depth {
                Some(maps) => maps.get(number, size)?,
                None => None,
            };
            missing.check(
                depth.is_some() && inverse_depth.is_none(),
                number,
                "no depth",
                "it gets no defocus",
            );
            let depth_to_look_at = inverse_depth.as_ref().filter(|_| !said);
            let left = depth_to_look_at.map_or(TooBlurred::default(), |d| matching.too_blurred(d));
            if left.share > 0.01 {
                said = true;
                observer.note(&format!(
                    "frame {number}: {:.0} % of the picture is less in focus than the other camera's would be, by a std of {:.1} px on average, and stays so (said once)",
                    100.0 * left.share,
                    left.sigma_px
                ));
            }
            let matched = matching
                .apply(&frame.image, number, inverse_depth.as_ref(), flow.as_ref(), seed)
                .map_err(of_frame)?;
            sink.put(&matched.0)
        };
        let made = for_each_frame("matching", (clip, &beside), sink, neighbours, observer, make);
        warn(observer, footage.clip.warning());
        made
    }
}
