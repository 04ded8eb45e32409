//! Grain for any other tool: the tiles as PNG, and the std over luminance as a table.

use super::{Abilities, Camera, Export, File, Shapes, grain};

pub(super) const ABILITIES: Abilities = Abilities {
    tool: "any tool that takes a grain texture or a response curve",
    motion_blur: "none",
    defocus: "none",
    bokeh: Shapes::DISKS,
    grain: "a tile of the whole noise, the four octaves as tiles, and the std over luminance of each channel and octave",
    checked: "std, spectrum, channel independence and seams measured on the textures",
};

/// The table, and the tiles.
pub(super) fn export(camera: &Camera) -> Export {
    let mut lost = camera.left.clone();
    let Some(noise) = &camera.noise else {
        let text = "# The noise is unknown.\nluminance\n".into();
        return Export { files: vec![File::text("blindaug_grain.csv", text)], lost };
    };
    lost.push("this is the noise only; motion blur and depth of field are in the other targets".into());
    let files = vec![
        File::text("blindaug_grain.csv", grain::table(noise)),
        File::texture(grain::TILE, grain::tile(noise)),
        File::texture(grain::BANDS, grain::bands()),
    ];
    Export { files, lost }
}
