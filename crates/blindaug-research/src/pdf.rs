//! Plots as PDF: a drawing backend of `plotters` that writes shapes and text, not pixels, with a font that every reader has.

use pdf_writer::{Content, Name, Pdf, Rect, Ref, Str};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
    FontTransform,
};
use std::convert::Infallible;

/// The size of a plot's unit, in points of 1/72 inch.
const UNIT: f32 = 0.5;
/// The distance of a circle's control points from its axes, as a share of the radius, for four cubic curves.
const ROUND: f32 = 0.552_285;

/// A page that takes shapes and text.
pub(crate) struct PdfBackend<'a> {
    content: Content,
    size: (u32, u32),
    file: &'a mut Vec<u8>,
}

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

impl<'a> PdfBackend<'a> {
    /// A page of `size` units. The file is complete when the page has been presented.
    pub(crate) fn new(file: &'a mut Vec<u8>, size: (u32, u32)) -> Self {
        let mut content = Content::new();
        content.transform([UNIT, 0.0, 0.0, UNIT, 0.0, 0.0]);
        Self { content, size, file }
    }

    /// The y axis of a PDF points up.
    fn at(&self, (x, y): BackendCoord) -> (f32, f32) {
        (x as f32, self.size.1 as f32 - y as f32)
    }

    fn outline(&mut self, points: impl IntoIterator<Item = BackendCoord>) {
        for (i, p) in points.into_iter().enumerate() {
            let (x, y) = self.at(p);
            if i == 0 {
                self.content.move_to(x, y)
            } else {
                self.content.line_to(x, y)
            };
        }
    }

    fn pen(&mut self, style: &impl BackendStyle) {
        let [r, g, b] = on_white(style.color());
        self.content.set_stroke_rgb(r, g, b).set_line_width(style.stroke_width() as f32);
    }

    fn ink(&mut self, color: BackendColor) {
        let [r, g, b] = on_white(color);
        self.content.set_fill_rgb(r, g, b);
    }
}

/// The colour that a translucent one gives on white paper.
fn on_white(color: BackendColor) -> [f32; 3] {
    let (r, g, b) = color.rgb;
    [r, g, b].map(|v| 1.0 - color.alpha as f32 * (1.0 - f32::from(v) / 255.0))
}

impl DrawingBackend for PdfBackend<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        self.size
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        let [catalog, pages, page, font, content] = [1, 2, 3, 4, 5].map(Ref::new);
        let mut pdf = Pdf::new();
        pdf.catalog(catalog).pages(pages);
        pdf.pages(pages).kids([page]).count(1);
        let mut sheet = pdf.page(page);
        let (w, h) = self.size;
        sheet
            .media_box(Rect::new(0.0, 0.0, UNIT * w as f32, UNIT * h as f32))
            .parent(pages)
            .contents(content);
        sheet.resources().fonts().pair(FONT, font);
        drop(sheet);
        pdf.type1_font(font).base_font(Name(b"Helvetica")).encoding_predefined(Name(b"WinAnsiEncoding"));
        pdf.stream(content, &std::mem::replace(&mut self.content, Content::new()).finish());
        *self.file = pdf.finish();
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> Drawn {
        let (x, y) = self.at(point);
        self.ink(color);
        self.content.rect(x, y - 1.0, 1.0, 1.0).fill_nonzero();
        Ok(())
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        self.draw_path([from, to], style)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        (left, top): BackendCoord,
        (right, bottom): BackendCoord,
        style: &S,
        fill: bool,
    ) -> Drawn {
        let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
        if fill {
            return self.fill_polygon(corners, style);
        }
        self.draw_path(corners.into_iter().chain([(left, top)]), style)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        self.pen(style);
        self.outline(path);
        self.content.stroke();
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        center: BackendCoord,
        radius: u32,
        style: &S,
        fill: bool,
    ) -> Drawn {
        let ((x, y), r) = (self.at(center), radius as f32);
        let k = ROUND * r;
        self.pen(style);
        self.ink(style.color());
        self.content
            .move_to(x + r, y)
            .cubic_to(x + r, y + k, x + k, y + r, x, y + r)
            .cubic_to(x - k, y + r, x - r, y + k, x - r, y)
            .cubic_to(x - r, y - k, x - k, y - r, x, y - r)
            .cubic_to(x + k, y - r, x + r, y - k, x + r, y);
        if fill {
            self.content.fill_nonzero()
        } else {
            self.content.stroke()
        };
        Ok(())
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        self.ink(style.color());
        self.outline(path);
        self.content.fill_nonzero();
        Ok(())
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, at: BackendCoord) -> Drawn {
        // The same rules as those of the SVG backend, so that both files look alike.
        let size = (style.size() / 1.24) as f32;
        let text: Vec<u8> = text.chars().map(win_ansi).collect();
        let width = size * text.iter().map(|&c| f32::from(width(c))).sum::<f32>() / 1000.0;
        let along = match style.anchor().h_pos {
            HPos::Left => 0.0,
            HPos::Center => -0.5 * width,
            HPos::Right => -width,
        };
        let down = size
            * match style.anchor().v_pos {
                VPos::Top => 0.76,
                VPos::Center => 0.26,
                VPos::Bottom => -0.26,
            };
        // The directions of the text and of its way up, in PDF's axes.
        let (dx, dy) = match style.transform() {
            FontTransform::Rotate90 => (0.0, -1.0),
            FontTransform::Rotate180 => (-1.0, 0.0),
            FontTransform::Rotate270 => (0.0, 1.0),
            _ => (1.0, 0.0),
        };
        let (x, y) = self.at(at);
        let start = [x + along * dx + down * dy, y + along * dy - down * dx];
        self.ink(style.color());
        self.content
            .begin_text()
            .set_font(FONT, size)
            .set_text_matrix([dx, dy, -dy, dx, start[0], start[1]])
            .show(Str(&text))
            .end_text();
        Ok(())
    }
}

const FONT: Name = Name(b"F");

/// The character in the Windows Latin 1 encoding; a question mark for what it lacks.
fn win_ansi(c: char) -> u8 {
    match c {
        '\u{2212}' => b'-',
        '\u{2013}' => 0x96,
        '\u{2014}' => 0x97,
        '\u{2019}' => 0x92,
        '\u{2026}' => 0x85,
        '\u{202f}' => 0xa0,
        ' '..='~' | '\u{a0}'..='\u{ff}' => u8::try_from(u32::from(c)).unwrap_or(b'?'),
        _ => b'?',
    }
}

/// The width of a character of Helvetica, in thousandths of the font's size (Adobe's font metrics); letters with accents as wide as a
/// typical lower-case letter.
fn width(c: u8) -> u16 {
    const ASCII: [u16; 95] = [
        278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556,
        556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667, 611, 778,
        722, 278, 500, 667, 556, 833, 722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278,
        278, 278, 469, 556, 333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556,
        556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584,
    ];
    ASCII.get(usize::from(c.wrapping_sub(b' '))).copied().unwrap_or(556)
}
