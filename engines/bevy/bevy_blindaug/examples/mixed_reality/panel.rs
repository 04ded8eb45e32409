//! The panel with the camera's numbers, and the sliders that set them by hand.

use bevy::prelude::*;
use bevy::ui_widgets::{Slider, SliderRange, SliderThumb, SliderValue, TrackClick, ValueChange, observe};
use bevy_blindaug::{ByHand, LiveCamera, MatchedCamera};
use blindaug::model::{DefocusCurve, ExposureFraction};

/// The height of the panel, px.
pub const HEIGHT: f32 = 104.0;
const THUMB: f32 = 12.0;

/// What a slider sets.
#[derive(Component, Clone, Copy, PartialEq, Eq)]
pub enum Sets {
    Exposure,
    Focus,
    Blur,
    Grain,
}

impl Sets {
    const ALL: [Self; 4] = [Self::Exposure, Self::Focus, Self::Blur, Self::Grain];

    /// The range of the slider: shares of the frame interval, the logarithm of metres, px, and a factor.
    fn range(self) -> [f32; 2] {
        match self {
            Self::Exposure => [0.0, 1.0],
            Self::Focus => [-1.6, 3.0],
            Self::Blur => [0.0, 12.0],
            Self::Grain => [0.0, 4.0],
        }
    }

    /// What was estimated, as the slider shows it.
    fn estimated(self, live: &LiveCamera) -> Option<f32> {
        let camera = &live.estimate()?.camera;
        let lens = camera.defocus.known().and_then(|lens| match lens.curve {
            DefocusCurve::ThinLens { sigma_px_at_infinity, focus_inverse_depth, .. } => {
                Some([sigma_px_at_infinity, focus_inverse_depth])
            }
            DefocusCurve::Quadratic { .. } => None,
        });
        match self {
            Self::Exposure => camera.motion_blur.known().map(|m| m.exposure.0),
            Self::Focus => lens.map(|[_, focus]| -focus.max(0.01).ln()),
            Self::Blur => lens.map(|[blur, _]| blur),
            Self::Grain => camera.noise.known().map(|_| 1.0),
        }
    }

    /// What is set by hand, as the slider shows it.
    fn set(self, by_hand: &ByHand) -> Option<f32> {
        match self {
            Self::Exposure => by_hand.exposure.map(|e| e.0),
            Self::Focus => by_hand.focus_m.map(f32::ln),
            Self::Blur => by_hand.blur_px,
            Self::Grain => by_hand.grain,
        }
    }

    /// The number in words.
    fn words(self, value: Option<f32>) -> String {
        match (self, value) {
            (Self::Exposure, Some(v)) => format!("exposure {v:.2}"),
            (Self::Focus, Some(v)) => format!("focus {:.2} m", v.exp()),
            (Self::Blur, Some(v)) => format!("blur {v:.1} px"),
            (Self::Grain, Some(v)) => format!("noise x {v:.1}"),
            (Self::Exposure, None) => "exposure unknown".into(),
            (Self::Focus, None) => "focus unknown".into(),
            (Self::Blur, None) => "blur unknown".into(),
            (Self::Grain, None) => "noise unknown".into(),
        }
    }
}

/// The text above a slider.
#[derive(Component)]
pub struct Label(Sets);

/// Spawns the panel at the lower edge of the camera's picture.
pub fn spawn(commands: &mut Commands) {
    let panel = Node {
        position_type: PositionType::Absolute,
        bottom: px(0),
        width: percent(100),
        height: px(HEIGHT),
        justify_content: JustifyContent::SpaceEvenly,
        align_items: AlignItems::Center,
        ..default()
    };
    let panel = commands.spawn((panel, BackgroundColor(Color::srgba(0.0, 0.0, 0.0, 0.6)))).id();
    for sets in Sets::ALL {
        let column =
            Node { flex_direction: FlexDirection::Column, row_gap: px(8), width: percent(22), ..default() };
        let column = commands.spawn((column, ChildOf(panel))).id();
        let font = TextFont { font_size: FontSize::Px(14.0), ..default() };
        commands.spawn((Label(sets), Text::default(), font, TextColor(Color::WHITE), ChildOf(column)));
        commands.spawn((slider(sets), observe(change), ChildOf(column)));
    }
}

/// A slider: a track, and a thumb on it.
fn slider(sets: Sets) -> impl Bundle {
    let [low, high] = sets.range();
    let track = Node {
        position_type: PositionType::Absolute,
        top: px(4),
        height: px(4),
        width: percent(100),
        ..default()
    };
    let way = Node {
        position_type: PositionType::Absolute,
        left: px(0),
        right: px(THUMB),
        height: px(THUMB),
        ..default()
    };
    let thumb = Node {
        position_type: PositionType::Absolute,
        width: px(THUMB),
        height: px(THUMB),
        border_radius: BorderRadius::MAX,
        ..default()
    };
    (
        sets,
        Node { width: percent(100), height: px(THUMB), ..default() },
        Slider { track_click: TrackClick::Snap, ..default() },
        SliderValue(low),
        SliderRange::new(low, high),
        children![
            (track, BackgroundColor(Color::srgb(0.4, 0.4, 0.4))),
            (way, children![(SliderThumb, thumb, BackgroundColor(Color::WHITE))]),
        ],
    )
}

/// Sets what a slider was moved to.
fn change(
    change: On<ValueChange<f32>>,
    sliders: Query<&Sets>,
    mut camera: Single<&mut MatchedCamera>,
    live: Res<LiveCamera>,
) {
    let Ok(&sets) = sliders.get(change.source) else { return };
    let by_hand = &mut camera.by_hand;
    match sets {
        Sets::Exposure => by_hand.exposure = Some(ExposureFraction(change.value)),
        Sets::Focus => by_hand.focus_m = Some(change.value.exp()),
        Sets::Blur => by_hand.blur_px = Some(change.value),
        Sets::Grain => by_hand.grain = Sets::Grain.estimated(&live).map(|_| change.value),
    }
    // A lens that is not known has neither of its two numbers: what is not set yet is that of a lens of 4 px in focus at the object.
    if matches!(sets, Sets::Focus | Sets::Blur) && Sets::Focus.estimated(&live).is_none() {
        by_hand.focus_m.get_or_insert(live.home.distance as f32);
        by_hand.blur_px.get_or_insert(4.0);
    }
}

/// Shows the numbers, by hand or estimated.
pub fn show(
    live: Res<LiveCamera>,
    camera: Single<&MatchedCamera>,
    mut commands: Commands,
    sliders: Query<(Entity, &Sets, &SliderValue, &SliderRange)>,
    children: Query<&Children>,
    mut thumbs: Query<&mut Node, With<SliderThumb>>,
    mut labels: Query<(&Label, &mut Text)>,
) {
    let shown = |sets: Sets| (sets.set(&camera.by_hand), sets.estimated(&live));
    for (Label(sets), mut text) in &mut labels {
        let (set, estimated) = shown(*sets);
        let how = if set.is_some() { "by hand" } else { "estimated" };
        let words = match (set, estimated) {
            (None, None) => sets.words(None),
            _ => format!("{}, {how}", sets.words(set.or(estimated))),
        };
        text.set_if_neq(Text(words));
    }
    for (slider, sets, value, range) in &sliders {
        let (set, estimated) = shown(*sets);
        let now = SliderValue(range.clamp(set.or(estimated).unwrap_or(range.start())));
        if now != *value {
            commands.entity(slider).insert(now);
        }
        for child in children.iter_descendants(slider) {
            if let Ok(mut thumb) = thumbs.get_mut(child) {
                thumb.left = percent(100.0 * range.thumb_position(now.0));
            }
        }
    }
}
