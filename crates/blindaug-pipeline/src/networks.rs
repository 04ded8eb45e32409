//! Neural networks in the five places of the paper's pipeline.

use crate::{Error, Footage, Observer, Operators, Result};
use blindaug::{
    Encoded,
    fit::{Evidence, Family},
};
use blindaug_nets::{Chain, Network, Removed, Slot, Slots, Store};

/// The networks of a job.
#[derive(Default)]
pub struct Networks {
    chain: Chain,
    names: Vec<String>,
    /// The networks' results for the last frame.
    removed: Removed,
}

impl Networks {
    /// Opens networks by their names or manifests. With `removal` and without names, the built-in networks, which remove something, are
    /// taken. The name `none` leaves all networks out. A network that is damaged is left out, and the observer is told.
    ///
    /// # Errors
    /// If there is no network of a name, a network is not installed, or two networks are for the same place.
    pub fn named(names: &[String], removal: bool, observer: &dyn Observer) -> Result<Self> {
        let store = Store::user();
        if names.iter().any(|n| n == "none") {
            return match names.len() {
                1 => Ok(Self::default()),
                _ => Err(Error::Networks("the network none cannot be combined with another network".into())),
            };
        }
        let mut slots = Slots::default();
        let mut used = vec![];
        let mut fill = |network: Network| {
            used.push(network.manifest().name.clone());
            slots.fill(network);
        };
        let mut filled: Vec<(Slot, String)> = vec![];
        for name in names {
            let manifest = store.find(name)?;
            store.check_installed(name)?;
            if let Some((slot, other)) = filled.iter().find(|f| f.0 == manifest.operator) {
                let sentence = format!("{other} and {name} are both for {}: name one", slot.name());
                return Err(Error::Networks(sentence));
            }
            filled.push((manifest.operator, name.clone()));
            match store.open(name) {
                Ok(network) => fill(network),
                Err(e) => fall_back(manifest.operator, &e, observer),
            }
        }
        if names.is_empty() && removal {
            Store::built_in()?.into_iter().for_each(fill);
        }
        Ok(Self { chain: Chain::new(slots), names: used, removed: Removed::default() })
    }

    /// Opens the networks of an estimate as [`Networks::named`] does, and tells the observer which. The built-in ones are taken if blur is to be
    /// estimated by its removal, no names are given, and no frames without blur are.
    ///
    /// # Errors
    /// The same as [`Networks::named`], and if a network removes something and the estimate has no use for that.
    pub fn for_estimate(
        names: &[String],
        family: Family,
        footage: &Footage,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let given = footage.has_removed();
        let networks = Self::named(names, family == Family::Removal && !given, observer)?;
        if networks.remove() && (given || family == Family::Spectral) {
            let why = if given { "such frames are given" } else { "the spectral method removes nothing" };
            return Err(Error::Networks(format!("{why}: name only networks of flow and depth")));
        }
        if !networks.is_empty() {
            observer.note(&format!("networks: {}", networks.names()));
        }
        Ok(networks)
    }

    /// The networks' names, joined by commas.
    pub fn names(&self) -> String {
        self.names.join(", ")
    }

    /// Whether there is no network.
    pub fn is_empty(&self) -> bool {
        self.chain.slots().is_empty()
    }

    /// Whether one of the networks removes something.
    pub fn remove(&self) -> bool {
        self.chain.slots().remove()
    }

    /// Forgets the frames so far, since another clip begins.
    pub fn clear(&mut self) {
        self.chain.clear();
    }

    /// Whether one of the networks removes noise.
    pub fn remove_noise(&self) -> bool {
        self.chain.slots().remove_noise.is_some()
    }

    /// Runs the networks on frame `at` of successive frames. A network that fails is left out from then on, and the observer is told.
    pub fn run(&mut self, frames: &[(u64, &Encoded)], at: usize, observer: &dyn Observer) -> &Removed {
        self.removed = self.chain.run(frames, at);
        for (slot, e) in self.removed.failed.drain(..) {
            fall_back(slot, &e, observer);
        }
        &self.removed
    }
}

impl Operators for Networks {
    fn reach(&self) -> usize {
        self.chain.reach()
    }

    fn evidence<'a>(
        &'a mut self,
        frames: &[(u64, &Encoded)],
        at: usize,
        given: Evidence<'a>,
        observer: &dyn Observer,
    ) -> Evidence<'a> {
        if self.is_empty() { given } else { or_removed(given, self.run(frames, at, observer)) }
    }
}

/// The given evidence, completed by the results of networks.
fn or_removed<'a>(given: Evidence<'a>, removed: &'a Removed) -> Evidence<'a> {
    let Removed { denoised, motion_deblurred, defocus_deblurred, flow, inverse_depth, .. } = removed;
    // Defocus is removed after motion blur, so that the result of both is clean.
    let (clean, defocus_only) = match motion_deblurred {
        Some(_) => (defocus_deblurred.as_deref(), None),
        None => (None, defocus_deblurred.as_deref()),
    };
    Evidence {
        flow: given.flow.or(flow.as_ref()),
        inverse_depth: given.inverse_depth.or(inverse_depth.as_ref().map(|(d, kind)| (d, *kind))),
        denoised: given.denoised.or(denoised.as_deref()),
        motion_deblurred: given.motion_deblurred.or(motion_deblurred.as_deref()),
        defocus_deblurred: given.defocus_deblurred.or(defocus_only),
        clean: given.clean.or(clean),
        by_network: given.by_network
            || [denoised, motion_deblurred, defocus_deblurred].iter().any(|i| i.is_some()),
        found_before: given.found_before,
    }
}

fn fall_back(slot: Slot, e: &blindaug_io::Error, observer: &dyn Observer) {
    observer.warning(&format!("{e}; {} is left to the classical method", slot.name()));
}
