// Stream a microphone array to the service from C++, by the conversation of docs/protocol.md.
//
// Build: c++ -std=c++17 -O2 examples/stream_client.cpp -o stream_client -pthread
//        (Debian and Ubuntu: apt install g++ libboost-dev nlohmann-json3-dev)
// Run:   ./stream_client [--fast] [--host HOST] [--port PORT] ARRAY recording.wav
//        arecord -t raw -f S16_LE -r 16000 -c 6 | ./stream_client ARRAY - 16000 6
//
// A WAV file is sent as fast as it was recorded; --fast sends it as fast as it is localized. "-"
// reads raw 16-bit samples from a program that records: they come in real time by themselves.
// NEURALMUSIC_KEY holds the key, where the service has keys. Exit code 0 after a complete session.

#include <boost/asio.hpp>
#include <boost/beast.hpp>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <future>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <vector>

namespace beast = boost::beast;
namespace net = boost::asio;
namespace websocket = beast::websocket;
using json = nlohmann::json;

constexpr double kMessageSeconds = 0.05;

struct Audio {
  std::istream* samples;  // interleaved sample frames, little endian
  std::string encoding = "pcm_s16le";
  unsigned sample_rate = 16000, channels = 1, frame_bytes = 2;
};

template <typename Number>
Number read_number(std::istream& in) {  // of a little-endian machine
  Number value{};
  in.read(reinterpret_cast<char*>(&value), sizeof value);
  return value;
}

// Reads a WAV file up to its samples, which are streamed as they are.
Audio open_wav(std::istream& in) {
  Audio audio{&in};
  char name[4], riff[12];
  in.read(riff, 12);
  if (!in || std::memcmp(riff, "RIFF", 4) || std::memcmp(riff + 8, "WAVE", 4))
    throw std::runtime_error("this is no WAV file");
  while (in.read(name, 4)) {
    const auto size = read_number<std::uint32_t>(in);
    if (!std::memcmp(name, "data", 4)) return audio;
    const auto body = in.tellg();
    if (!std::memcmp(name, "fmt ", 4)) {
      auto format = read_number<std::uint16_t>(in);
      audio.channels = read_number<std::uint16_t>(in);
      audio.sample_rate = read_number<std::uint32_t>(in);
      in.ignore(4);
      audio.frame_bytes = read_number<std::uint16_t>(in);
      const auto bits = read_number<std::uint16_t>(in);
      if (format == 0xFFFE) {  // the extensible header says further on what the samples are
        in.ignore(8);
        format = read_number<std::uint16_t>(in);
      }
      if (bits < 16 || (format != 1 && format != 3)) throw std::runtime_error("unknown samples");
      audio.encoding = format == 3 ? "pcm_f32le" : "pcm_s" + std::to_string(bits) + "le";
    }
    in.seekg(body + std::streamoff(size + size % 2));
  }
  throw std::runtime_error("the WAV file has no samples");
}

class Stream {
 public:
  // Connects, sends `start` and waits for `ready`.
  Stream(const std::string& host, const std::string& port, const json& start) : socket_(io_) {
    beast::get_lowest_layer(socket_).connect(net::ip::tcp::resolver(io_).resolve(host, port));
    socket_.set_option(websocket::stream_base::decorator([](websocket::request_type& request) {
      request.set(beast::http::field::sec_websocket_protocol, "doa.v1");
      if (const char* key = std::getenv("NEURALMUSIC_KEY"))
        request.set(beast::http::field::authorization, std::string("Bearer ") + key);
    }));
    websocket::response_type answer;
    beast::error_code refused;
    // Not handshake(), which keeps the problem document of a refusal to itself.
    socket_.async_handshake(answer, host + ":" + port, "/stream",
                            [&](beast::error_code error) { refused = error; });
    io_.run();
    io_.restart();
    if (refused) throw std::runtime_error(refused.message() + " " + answer.body());
    socket_.write(net::buffer(start.dump()));
    std::string kind;  // a ready, or an error and the end
    while (kind != "ready") {
      socket_.read(buffer_);
      kind = show();
    }
  }

  // Sends one message and returns once the network has taken it; from the thread of the audio.
  void send(const std::string& message, bool binary) {
    std::promise<void> taken;
    net::post(io_, [&] {
      socket_.binary(binary);
      socket_.async_write(net::buffer(message), [&](beast::error_code error, std::size_t) {
        if (error) taken.set_exception(std::make_exception_ptr(beast::system_error(error)));
        else taken.set_value();
      });
    });
    taken.get_future().get();
  }

  // Shows what the service says while `talk` sends from its own thread; the close code.
  template <typename Talk>
  int run(Talk talk) {
    auto talking = net::make_work_guard(io_);  // what is still sent must not wait for ever
    std::thread talker([&] {
      try {
        talk();
      } catch (const std::exception&) {  // the session has ended: its last message says why
      }
      talking.reset();
    });
    read();
    io_.run();
    talker.join();
    return socket_.reason().code;
  }

 private:
  void read() {
    socket_.async_read(buffer_, [this](beast::error_code error, std::size_t) {
      if (error) return;  // closed, by the service or the network
      show();
      read();
    });
  }

  // Prints what a robot acts on; the message's type.
  std::string show() {
    const auto message = json::parse(beast::buffers_to_string(buffer_.data()));
    buffer_.clear();
    const std::string type = message["type"];
    if (type == "result")
      for (const auto& source : message["sources"])
        std::cout << message["t_end"] << " s  id " << source["id"] << "  " << source["azimuth_deg"]
                  << " degrees" << (source["active"] ? "" : ", pauses") << std::endl;
    else if (type == "warning" || type == "error")
      std::cerr << message["code"] << ": " << message["detail"] << std::endl;
    else if (type == "summary")
      for (const auto& track : message["sources"])
        std::cout << "track " << track["id"] << ": " << track["azimuth_deg"] << " degrees, "
                  << track["active_s"] << " s" << std::endl;
    return type;
  }

  net::io_context io_;
  websocket::stream<beast::tcp_stream> socket_;
  beast::flat_buffer buffer_;
};

// Sends the audio block by block, then asks for the end.
void send_audio(Stream& to, const Audio& audio, bool paced) {
  const auto frames = std::size_t(kMessageSeconds * audio.sample_rate);
  const std::chrono::duration<double> length(double(frames) / audio.sample_rate);
  const auto began = std::chrono::steady_clock::now();
  std::string block(frames * audio.frame_bytes, '\0');
  for (int sent = 1;; ++sent) {
    audio.samples->read(block.data(), block.size());
    const auto whole = audio.samples->gcount() / audio.frame_bytes * audio.frame_bytes;
    if (whole == 0) break;
    to.send(block.substr(0, whole), true);
    if (paced) std::this_thread::sleep_until(began + sent * length);
  }
  to.send(R"({"type":"stop"})", false);
}

int usage() {
  std::cerr << "usage: stream_client [--fast] [--host HOST] [--port PORT] ARRAY FILE.wav\n"
               "       stream_client [--fast] ... ARRAY - SAMPLE_RATE CHANNELS\n";
  return 2;
}

int main(int count, char** words) try {
  std::vector<std::string> given(words + 1, words + count);
  std::string host = "127.0.0.1", port = "8000";
  bool fast = false;
  while (given.size() > 1 && given[0].rfind("--", 0) == 0) {
    if (given[0] == "--fast") fast = true;
    else if (given[0] == "--host") host = given[1];
    else if (given[0] == "--port") port = given[1];
    else return usage();
    given.erase(given.begin(), given.begin() + (given[0] == "--fast" ? 1 : 2));
  }
  if (given.size() != 2 && !(given.size() == 4 && given[1] == "-")) return usage();
  std::ifstream file;
  Audio audio{&std::cin};
  const bool recorded = given[1] != "-";
  if (recorded) {
    file.open(given[1], std::ios::binary);
    if (!file) throw std::runtime_error(given[1] + " cannot be opened");
    audio = open_wav(file);
  } else {
    audio.sample_rate = std::stoul(given[2]);
    audio.channels = std::stoul(given[3]);
    audio.frame_bytes = 2 * audio.channels;
  }
  const json start = {{"type", "start"},
                      {"audio",
                       {{"encoding", audio.encoding},
                        {"sample_rate", audio.sample_rate},
                        {"channels", audio.channels}}},
                      {"array", {{"name", given[0]}}},
                      {"overflow", fast ? "block" : "drop_oldest"}};
  Stream stream(host, port, start);
  const int code = stream.run([&] { send_audio(stream, audio, recorded && !fast); });
  if (code != 1000) std::cerr << "closed with " << code << std::endl;
  return code == 1000 ? 0 : 1;
} catch (const std::exception& error) {
  std::cerr << "error: " << error.what() << std::endl;
  return 1;
}
