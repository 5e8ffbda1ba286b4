//! Who may command: one operator at a time.

use crate::Refusal;

/// Longest operator name that is kept, characters.
const MAX_NAME: usize = 64;

/// The right to command a station. Numbers only count up, so that an old one is never valid again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lease(pub u64);

/// Who has the lease.
#[derive(Clone, Debug)]
pub(crate) struct Holder {
    pub(crate) operator: String,
    pub(crate) lease: Lease,
    /// Last sign of life, which keeps the lease.
    pub(crate) renewed_ns: u64,
}

/// The only lease of a station.
#[derive(Clone, Debug)]
pub(crate) struct LeaseDesk {
    ttl_ns: u64,
    newest: u64,
    holder: Option<Holder>,
}

impl LeaseDesk {
    pub(crate) fn new(ttl_ns: u64) -> Self {
        Self { ttl_ns, newest: 0, holder: None }
    }

    /// Who has the lease at `now_ns`.
    pub(crate) fn holder(&self, now_ns: u64) -> Option<&Holder> {
        self.holder.as_ref().filter(|holder| now_ns.saturating_sub(holder.renewed_ns) < self.ttl_ns)
    }

    pub(crate) fn left_ns(&self, now_ns: u64) -> u64 {
        self.holder(now_ns)
            .map_or(0, |holder| self.ttl_ns - now_ns.saturating_sub(holder.renewed_ns).min(self.ttl_ns))
    }

    /// The holder whose lease has run out by now, once.
    pub(crate) fn expire(&mut self, now_ns: u64) -> Option<Holder> {
        if self.holder(now_ns).is_some() { None } else { self.holder.take() }
    }

    /// A new lease for `operator`, and who had one until now.
    pub(crate) fn acquire(
        &mut self,
        now_ns: u64,
        operator: &str,
        take_over: bool,
    ) -> Result<(Lease, Option<Holder>), Refusal> {
        let operator = name(operator);
        if operator.is_empty() {
            return Err(Refusal::NoName);
        }
        if let Some(holder) = self.holder(now_ns).filter(|_| !take_over) {
            let left_s = self.left_ns(now_ns) as f64 * 1e-9;
            return Err(Refusal::Held { holder: holder.operator.clone(), left_s });
        }
        self.newest += 1;
        let lease = Lease(self.newest);
        let before = self.holder.replace(Holder { operator, lease, renewed_ns: now_ns });
        Ok((lease, before))
    }

    /// The holder, if `lease` is theirs.
    pub(crate) fn check(&mut self, now_ns: u64, lease: Lease) -> Result<&mut Holder, Refusal> {
        let now_with = match self.holder(now_ns) {
            Some(holder) if holder.lease != lease => format!(", {:?} has control now", holder.operator),
            _ => String::new(),
        };
        let ttl_ns = self.ttl_ns;
        self.holder
            .as_mut()
            .filter(|holder| holder.lease == lease && now_ns.saturating_sub(holder.renewed_ns) < ttl_ns)
            .ok_or(Refusal::LeaseEnded { lease: lease.0, now_with })
    }

    pub(crate) fn release(&mut self) {
        self.holder = None;
    }
}

/// A name as it is shown to others: no control characters, and no longer than a line.
pub(crate) fn name(text: &str) -> String {
    text.trim().chars().filter(|c| !c.is_control()).take(MAX_NAME).collect()
}
