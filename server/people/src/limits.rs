//! Attempts to log in: so many an account, and so many an address.
//!
//! Each attempt takes a permit of its address and one of its account before the password is looked at, and a login gives
//! both back. Permits come back slowly. Addresses from which somebody has logged in before need no permit of that account,
//! so that nobody is locked out of an account by others who guess.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::IpAddr,
    sync::{Mutex, MutexGuard, PoisonError},
};

/// Attempts at once, and seconds until one more.
const ADDRESS: Rule = Rule { burst: 10, refill_s: 60 };
const ACCOUNT: Rule = Rule { burst: 20, refill_s: 60 };
/// Accounts or addresses that are counted apart; all beyond share one count.
const MAX_COUNTED: usize = 4096;
/// Pairs of account and address that are remembered.
const MAX_TRUSTED: usize = 1024;

#[derive(Clone, Copy, Debug)]
struct Rule {
    burst: i64,
    refill_s: i64,
}

/// Counts attempts to log in.
#[derive(Debug, Default)]
pub struct LoginLimits {
    counts: Mutex<Counts>,
}

#[derive(Debug, Default)]
struct Counts {
    addresses: Bins,
    accounts: Bins,
    trusted: BTreeSet<(String, Address)>,
}

/// An address; of IPv6 the network, since whoever has one address there has them all.
type Address = [u8; 8];

/// When all attempts of each key would be back, s: each attempt moves that time on.
#[derive(Debug, Default)]
struct Bins {
    full_at_s: BTreeMap<String, i64>,
}

impl Bins {
    /// Takes a permit, or says after how many seconds there will be one.
    fn take(&mut self, rule: Rule, key: &str, now_s: i64) -> Result<(), i64> {
        if self.full_at_s.len() >= MAX_COUNTED && !self.full_at_s.contains_key(key) {
            self.full_at_s.retain(|_, full_at_s| *full_at_s > now_s);
        }
        let key = self.counted(key);
        let full_at_s = self.full_at_s.entry(key).or_insert(now_s);
        let next = (*full_at_s).max(now_s) + rule.refill_s;
        let too_late = next - (now_s + rule.burst * rule.refill_s);
        if too_late > 0 {
            return Err(too_late);
        }
        *full_at_s = next;
        Ok(())
    }

    fn give_back(&mut self, rule: Rule, key: &str) {
        if let Some(full_at_s) = self.full_at_s.get_mut(&self.counted(key)) {
            *full_at_s -= rule.refill_s;
        }
    }

    fn counted(&self, key: &str) -> String {
        let is_counted = self.full_at_s.len() < MAX_COUNTED || self.full_at_s.contains_key(key);
        if is_counted { key.to_owned() } else { String::new() }
    }
}

fn network(address: Option<IpAddr>) -> Address {
    match address.map(|address| address.to_canonical()) {
        Some(IpAddr::V4(address)) => {
            let [a, b, c, d] = address.octets();
            [0, 0, 0, 4, a, b, c, d]
        }
        Some(IpAddr::V6(address)) => {
            let [a, b, c, d, e, f, g, h, ..] = address.octets();
            [a, b, c, d, e, f, g, h]
        }
        None => [0; 8],
    }
}

impl LoginLimits {
    /// Permits an attempt to log in as `account` from `address`, or says after how many seconds the next one is.
    pub fn take(&self, account: &str, address: Option<IpAddr>, now_s: i64) -> Result<(), i64> {
        let (network, mut counts) = (network(address), self.lock());
        let key = format!("{network:?}");
        counts.addresses.take(ADDRESS, &key, now_s)?;
        if counts.trusted.contains(&(account.to_owned(), network)) {
            return Ok(());
        }
        let taken = counts.accounts.take(ACCOUNT, account, now_s);
        if taken.is_err() {
            counts.addresses.give_back(ADDRESS, &key);
        }
        taken
    }

    /// Notes that an attempt that was permitted was a login.
    pub fn succeeded(&self, account: &str, address: Option<IpAddr>) {
        let (network, mut counts) = (network(address), self.lock());
        counts.addresses.give_back(ADDRESS, &format!("{network:?}"));
        if !counts.trusted.contains(&(account.to_owned(), network)) {
            counts.accounts.give_back(ACCOUNT, account);
            if counts.trusted.len() < MAX_TRUSTED {
                counts.trusted.insert((account.to_owned(), network));
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn address(last: u8) -> Option<IpAddr> {
        Some(IpAddr::from([10, 0, 0, last]))
    }

    #[test]
    fn an_address_has_ten_attempts_and_then_one_a_minute() {
        let limits = LoginLimits::default();
        for attempt in 0..10 {
            // Whatever accounts it tries.
            assert_eq!(limits.take(&format!("name{attempt}"), address(1), 1000), Ok(()));
        }
        assert_eq!(limits.take("ada", address(1), 1000), Err(60));
        assert_eq!(limits.take("ada", address(2), 1000), Ok(()), "others are free");
        assert_eq!(limits.take("ada", address(1), 1059), Err(1));
        assert_eq!(limits.take("ada", address(1), 1060), Ok(()));
        assert_eq!(limits.take("ada", address(1), 1060), Err(60));
    }

    #[test]
    fn an_account_has_twenty_whatever_addresses_they_come_from_but_not_where_it_was_used_before() {
        let limits = LoginLimits::default();
        assert_eq!(limits.take("ada", address(200), 1000), Ok(()));
        limits.succeeded("ada", address(200));
        for attempt in 0..20 {
            assert_eq!(limits.take("ada", address(attempt), 1000), Ok(()));
        }
        assert_eq!(limits.take("ada", address(100), 1000), Err(60));
        assert_eq!(limits.take("bob", address(100), 1000), Ok(()));
        assert_eq!(limits.take("ada", address(200), 1000), Ok(()), "her own place is not locked");
    }

    #[test]
    fn a_network_of_ipv6_is_one_address_and_mapped_addresses_are_themselves() {
        let network = |text: &str| super::network(Some(text.parse().unwrap()));
        assert_eq!(network("2001:db8:1:2::1"), network("2001:db8:1:2:ffff::7"));
        assert_ne!(network("2001:db8:1:2::1"), network("2001:db8:1:3::1"));
        assert_eq!(network("::ffff:10.0.0.1"), network("10.0.0.1"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// However attempts are spread over time, no account gets more than its burst and what came back meanwhile, and
        /// what is remembered is bounded.
        #[test]
        fn attempts_are_bounded(steps in prop::collection::vec((0_i64..120, 0_u8..3), 1..400)) {
            let limits = LoginLimits::default();
            let (mut now_s, mut permitted) = (1_000_000, 0);
            let begun = now_s;
            for (pause_s, last) in steps {
                now_s += pause_s;
                permitted += i64::from(limits.take("ada", address(last), now_s).is_ok());
                prop_assert!(permitted <= ACCOUNT.burst + (now_s - begun) / ACCOUNT.refill_s);
            }
        }
    }

    #[test]
    fn memory_is_bounded_and_strangers_beyond_it_share_a_count() {
        let limits = LoginLimits::default();
        let mut permitted = 0;
        for number in 0..6_000_u32 {
            let address = Some(IpAddr::from(number.to_be_bytes()));
            permitted += usize::from(limits.take(&format!("a{number}"), address, 1000).is_ok());
        }
        let counts = limits.lock();
        assert!(counts.addresses.full_at_s.len() <= MAX_COUNTED + 1);
        assert!(counts.accounts.full_at_s.len() <= MAX_COUNTED + 1);
        assert!((MAX_COUNTED..MAX_COUNTED + 30).contains(&permitted), "{permitted}");
    }
}
