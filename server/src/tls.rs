//! TLS: certificates of the lab, or one of the studio's own, which is made at the first start and kept.

use std::{
    fs,
    io::Write as _,
    os::unix::fs::OpenOptionsExt as _,
    path::{Path, PathBuf},
    sync::Arc,
};

use sha2::{Digest as _, Sha256};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        ServerConfig,
        crypto::ring,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
    },
};

use crate::Error;

/// Folder of the own certificate in the data folder.
const FOLDER: &str = "tls";

/// Which certificate the studio shows.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Tls {
    /// The own one where the studio listens beyond its computer; no TLS elsewhere.
    #[default]
    Auto,
    /// The own one.
    Own,
    /// Files in PEM: the chain, and its key.
    Files {
        /// The certificate, followed by those that signed it.
        cert: PathBuf,
        /// The private key of the certificate.
        key: PathBuf,
    },
}

/// TLS that is ready to serve.
#[derive(Clone)]
pub(crate) struct TlsIdentity {
    pub(crate) acceptor: TlsAcceptor,
    /// SHA-256 of the certificate, as browsers and openssl show it.
    pub(crate) fingerprint: String,
    /// Where the certificate is, for clients that have to be told to trust it; `None` for one of the lab.
    pub(crate) own_cert: Option<PathBuf>,
}

impl TlsIdentity {
    /// Reads the certificate and key of these files.
    pub(crate) fn of_files(cert: &Path, key: &Path) -> Result<Self, Error> {
        let content = |path: &Path, what: &str, err: &dyn std::fmt::Display| {
            Error::Content(format!("{path:?} holds no {what} in PEM: {err}"))
        };
        let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_file_iter(cert)
            .and_then(Iterator::collect)
            .map_err(|err| content(cert, "certificate", &err))?;
        let Some(first) = chain.first() else {
            return Err(content(cert, "certificate", &"there is no CERTIFICATE section"));
        };
        let fingerprint = fingerprint(first);
        let key_der = PrivateKeyDer::from_pem_file(key).map_err(|err| content(key, "private key", &err))?;
        let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|err| Error::Internal(err.to_string()))?
            .with_no_client_auth()
            .with_single_cert(chain, key_der)
            .map_err(|err| Error::Content(format!("{cert:?} and {key:?} do not belong together: {err}")))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        // A ticket comes after the handshake, while the client's first request is under way. Clients that read in one
        // thread and write in another, as Python's `websockets.sync` does, lost about one connection in a hundred to
        // that: OpenSSL permits one thread at a time. Without tickets a connection costs a whole handshake, about a
        // millisecond.
        config.send_tls13_tickets = 0;
        Ok(Self { acceptor: TlsAcceptor::from(Arc::new(config)), fingerprint, own_cert: None })
    }

    /// The certificate of the data folder `data`, which is made if it is not there, or lacks one of `names`.
    pub(crate) fn own(data: &Path, names: &[String]) -> Result<Self, Error> {
        let folder = data.join(FOLDER);
        let (cert, key, known) = (folder.join("cert.pem"), folder.join("key.pem"), folder.join("names.txt"));
        fs::create_dir_all(&folder).map_err(Error::io("make", &folder))?;
        let known_names = fs::read_to_string(&known).unwrap_or_default();
        let is_complete = names.iter().all(|name| known_names.lines().any(|known| known == name));
        if !is_complete || !cert.is_file() || !key.is_file() {
            let unusable = |err: rcgen::Error| {
                Error::Argument(format!("no certificate can be made for {}: {err}", names.join(", ")))
            };
            let made = rcgen::generate_simple_self_signed(names).map_err(unusable)?;
            write_private(&key, &made.signing_key.serialize_pem())?;
            write_private(&cert, &made.cert.pem())?;
            // Last, so that what was cut off is made again.
            write_private(&known, &(names.join("\n") + "\n"))?;
        }
        Ok(Self { own_cert: Some(cert.clone()), ..Self::of_files(&cert, &key)? })
    }
}

/// Writes a file that nobody else on this computer reads.
fn write_private(path: &Path, text: &str) -> Result<(), Error> {
    let new = path.with_extension("new");
    let _ = fs::remove_file(&new);
    let mut file = fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&new)
        .map_err(Error::io("write", &new))?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(Error::io("write", &new))?;
    fs::rename(&new, path).map_err(Error::io("write", path))
}

/// The names by which clients may call the studio that listens on `listen`, and `hosts` besides.
pub(crate) fn names(listen: std::net::SocketAddr, hosts: &[String]) -> Vec<String> {
    let mut names = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    let mut add = |name: String| {
        if !name.is_empty() && !names.contains(&name) {
            names.push(name);
        }
    };
    if !listen.ip().is_unspecified() {
        add(listen.ip().to_string());
    }
    add(rustix::system::uname().nodename().to_string_lossy().to_ascii_lowercase());
    hosts.iter().for_each(|host| add(host.to_ascii_lowercase()));
    names
}

/// SHA-256 of a certificate, as pairs of hexadecimal digits.
fn fingerprint(cert: &CertificateDer<'_>) -> String {
    let pairs: Vec<String> = Sha256::digest(cert.as_ref()).iter().map(|byte| format!("{byte:02X}")).collect();
    pairs.join(":")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_certificate_stays_until_a_name_is_missing_and_nobody_else_reads_its_key() {
        use std::os::unix::fs::PermissionsExt as _;
        let data = tempfile::tempdir().unwrap();
        let names = |more: &[&str]| {
            let more: Vec<String> = more.iter().map(|&name| name.to_owned()).collect();
            super::names("10.0.0.7:8443".parse().unwrap(), &more)
        };
        let first = TlsIdentity::own(data.path(), &names(&[])).unwrap();
        let mode = data.path().join("tls/key.pem").metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
        assert_eq!(first.fingerprint.len(), 32 * 3 - 1, "{}", first.fingerprint);
        assert_eq!(TlsIdentity::own(data.path(), &names(&[])).unwrap().fingerprint, first.fingerprint);
        let named = TlsIdentity::own(data.path(), &names(&["palpate.lab.example"])).unwrap();
        assert_ne!(named.fingerprint, first.fingerprint);
        // A key that was cut off is made again.
        fs::remove_file(data.path().join("tls/key.pem")).unwrap();
        assert_ne!(TlsIdentity::own(data.path(), &names(&[])).unwrap().fingerprint, named.fingerprint);
    }

    #[test]
    fn files_that_are_no_certificate_or_no_pair_are_named() {
        let (one, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let names = ["localhost".to_owned()];
        TlsIdentity::own(one.path(), &names).unwrap();
        TlsIdentity::own(other.path(), &names).unwrap();
        let (cert, key) = (one.path().join("tls/cert.pem"), other.path().join("tls/key.pem"));
        for (cert, key, words) in [
            (&key, &key, "no certificate"),
            (&cert, &cert, "no private key"),
            (&cert, &key, "do not belong together"),
            (&one.path().join("none.pem"), &key, "none.pem"),
        ] {
            let err = TlsIdentity::of_files(cert, key).err().unwrap().to_string();
            assert!(err.contains(words), "{err}");
        }
    }
}
