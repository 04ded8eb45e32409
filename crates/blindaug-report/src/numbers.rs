//! Numbers formatted for people.

use serde_json::{Value, json};

/// The number with three significant figures, without an exponent.
pub fn number(v: f64) -> String {
    if v.is_nan() {
        return "unknown".into();
    }
    if v.is_infinite() {
        return if v > 0.0 { "∞".into() } else { "−∞".into() };
    }
    // The rounded value decides: 9.996 has as many figures as 10.0.
    let order = |v: f64| if v == 0.0 { 0 } else { v.abs().log10().floor() as i32 };
    let decimals = |order: i32| (2 - order).clamp(0, 5) as usize;
    let rounded: f64 = format!("{:.*}", decimals(order(v)), v).parse().unwrap_or(v);
    if rounded == 0.0 {
        return "0".into();
    }
    format!("{:.*}", decimals(order(rounded)), rounded).replace('-', "−")
}

/// The same as [`number`], without zeros at the end: for axes.
pub fn tick(v: f64) -> String {
    let text = number(v);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// The text "low to high unit" of an interval, in rising order.
pub fn interval([a, b]: [f64; 2], unit: &str) -> String {
    format!("{} to {}{unit}", number(a.min(b)), number(a.max(b)))
}

/// A whole number with its digits in groups of three.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(c);
    }
    text
}

/// The distance in m of an inverse depth in 1/m; infinite beyond 10 km and for negative inverse depths, as to any lens.
pub fn distance(inverse_depth: f64) -> f64 {
    if inverse_depth > 1e-4 { 1.0 / inverse_depth } else { f64::INFINITY }
}

/// The distance of an inverse depth in 1/m, in words.
pub fn metres(inverse_depth: f64) -> String {
    match distance(inverse_depth) {
        d if d.is_infinite() => "infinity".into(),
        d => format!("{} m", number(d)),
    }
}

/// The value with its numbers at six significant digits, as they are written: a number that went through f32 has no dust behind it then.
pub fn tidy(value: Value) -> Value {
    match value {
        Value::Number(n) => match (n.is_f64(), n.as_f64()) {
            (true, Some(v)) => format!("{v:.5e}").parse::<f64>().map_or(Value::Number(n), |v| json!(v)),
            _ => Value::Number(n),
        },
        Value::Array(values) => values.into_iter().map(tidy).collect(),
        Value::Object(fields) => fields.into_iter().map(|(key, value)| (key, tidy(value))).collect(),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_has_no_dust() {
        let dusty = json!({ "a": [0.48f32, 1234.5678f32, 5, -0.0], "b": null, "c": "0.47999998211860657" });
        assert!(dusty.to_string().contains("0.479999"));
        let tidied = tidy(dusty).to_string();
        assert_eq!(tidied, r#"{"a":[0.48,1234.57,5,-0.0],"b":null,"c":"0.47999998211860657"}"#);
    }

    #[test]
    fn numbers_have_three_figures() {
        for (v, want) in [
            (0.0, "0"),
            (-0.0, "0"),
            (1e-9, "0"),
            (0.012_345, "0.0123"),
            (9.996, "10.0"),
            (172.8, "173"),
            (1234.5, "1234"),
            (-2.5, "−2.50"),
            (f64::NAN, "unknown"),
            (f64::INFINITY, "∞"),
        ] {
            assert_eq!(number(v), want);
        }
        assert_eq!(tick(0.5), "0.5");
        assert_eq!(tick(100.0), "100");
        assert_eq!(interval([2.0, 1.0], " m"), "1.00 to 2.00 m");
        assert_eq!(count(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(count(123), "123");
        assert_eq!(distance(-0.1), f64::INFINITY);
        assert_eq!(metres(0.0), "infinity");
        assert_eq!(metres(0.5), "2.00 m");
    }
}
