//! The memory budget of the whole process. The memory that a file's head asks for, or that a computation needs, is checked against
//! the budget before anything is allocated.

use crate::{Error, Result};
use std::{
    path::Path,
    sync::{
        OnceLock,
        atomic::{AtomicU64, Ordering},
    },
};

/// The memory that a machine is assumed to have if the system does not tell (any but Linux), bytes.
pub const ASSUMED: u64 = 8_000_000_000;

/// The budget, bytes; 0 stands for the default.
static BUDGET: AtomicU64 = AtomicU64::new(0);

/// Sets the budget, bytes; 0 restores the default.
pub fn set_budget(bytes: u64) {
    BUDGET.store(bytes, Ordering::Relaxed);
}

/// The budget, bytes. The default is half of the machine's memory, or half of its control group's limit if that is less.
pub fn budget() -> u64 {
    static DEFAULT: OnceLock<u64> = OnceLock::new();
    match BUDGET.load(Ordering::Relaxed) {
        0 => *DEFAULT.get_or_init(|| installed() / 2),
        set => set,
    }
}

/// Fails if `what` ("the picture", say), which the file at `path` asks for, takes more bytes than the budget.
///
/// # Errors
/// If the budget is exceeded; the sentence gives both numbers and a remedy.
pub fn fits(path: &Path, what: &str, bytes: u64) -> Result<()> {
    let budget = budget();
    if bytes <= budget {
        return Ok(());
    }
    Err(Error::over_budget(
        path,
        format!(
            "{what} takes {} of memory, and the budget is {}: raise it, or use smaller or fewer frames",
            in_words(bytes),
            in_words(budget)
        ),
    ))
}

/// A number of bytes as "1.5 GB" or "200 MB" (powers of ten), rounded up.
pub fn in_words(bytes: u64) -> String {
    match bytes {
        0..1_000_000_000 => format!("{} MB", bytes.div_ceil(1_000_000)),
        _ => format!("{:.1} GB", bytes.div_ceil(100_000_000) as f64 / 10.0),
    }
}

/// The memory that may be taken now, bytes: the free memory if the system tells it, but no more than the budget.
pub fn free() -> u64 {
    kilobytes("/proc/meminfo", "MemAvailable:").map_or(budget(), |free| free.min(budget()))
}

/// The largest memory that this process has had, bytes, if the system tells it.
pub fn most() -> Option<u64> {
    kilobytes("/proc/self/status", "VmHWM:")
}

/// The memory of the machine, bytes, or the limit of its control group if that is less.
fn installed() -> u64 {
    let machine = kilobytes("/proc/meminfo", "MemTotal:").unwrap_or(ASSUMED);
    let groups = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    limit_of_groups(Path::new("/sys/fs/cgroup"), &groups).map_or(machine, |limit| limit.min(machine))
}

/// The least limit, bytes, of the control groups that a process is in (the lines of `/proc/self/cgroup`) and of their parents.
fn limit_of_groups(root: &Path, lines: &str) -> Option<u64> {
    let limits = lines.lines().filter_map(|line| {
        let mut parts = line.splitn(3, ':');
        let (id, controllers, group) = (parts.next()?, parts.next()?, parts.next()?);
        // Control groups of version 2 have one hierarchy for all controllers, those of version 1 have one for memory.
        let (root, file) = match controllers {
            "" if id == "0" => (root.to_path_buf(), "memory.max"),
            c if c.split(',').any(|c| c == "memory") => (root.join("memory"), "memory.limit_in_bytes"),
            _ => return None,
        };
        let group = root.join(group.trim_start_matches('/'));
        let of = |g: &Path| std::fs::read_to_string(g.join(file)).ok()?.trim().parse::<u64>().ok();
        group.ancestors().take_while(|g| g.starts_with(&root)).filter_map(of).min()
    });
    limits.min()
}

/// The value, in bytes, of the line that begins with `key` and gives kB.
fn kilobytes(path: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(key))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kb| kb << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_limit_of_a_group_and_of_those_above_it_holds() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let limit = |group: &str, file: &str, text: &str| {
            std::fs::create_dir_all(root.join(group)).unwrap();
            std::fs::write(root.join(group).join(file), text).unwrap();
        };
        limit("a/b", "memory.max", "max\n");
        limit("a", "memory.max", "3000000\n");
        assert_eq!(limit_of_groups(root, "0::/a/b\n"), Some(3_000_000));
        limit("a/b", "memory.max", "2000000\n");
        assert_eq!(limit_of_groups(root, "0::/a/b\n"), Some(2_000_000));
        assert_eq!(limit_of_groups(root, "0::/\n"), None);
        limit("memory/c", "memory.limit_in_bytes", "1000000\n");
        assert_eq!(limit_of_groups(root, "4:cpu,memory:/c\n0::/a/b\n"), Some(1_000_000));
        // This is a group's name on the host, which does not exist inside a container; there the root's limit holds.
        limit("memory", "memory.limit_in_bytes", "7000000\n");
        assert_eq!(limit_of_groups(root, "4:memory:/docker/0123\n"), Some(7_000_000));
        assert_eq!(limit_of_groups(root, "nonsense\n\n::\n"), None);
    }

    #[test]
    fn more_than_the_budget_is_refused_in_one_sentence() {
        let path = Path::new("huge.png");
        assert_eq!(fits(path, "the picture", budget()), Ok(()));
        let e = fits(path, "the picture", u64::MAX).unwrap_err().to_string();
        assert!(e.starts_with("huge.png: the picture takes 18446744073.8 GB of memory"), "{e}");
        assert!(e.contains(&in_words(budget())) && e.contains("raise it"), "{e}");
        assert_eq!(in_words(1_500_000_000), "1.5 GB");
        assert_eq!(in_words(199_000_001), "200 MB");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn linux_tells() {
        assert!(installed() > 1 << 26 && budget() <= installed() && free() <= budget());
        assert!(most().is_some_and(|m| m > 1 << 20));
    }
}
