#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <random>

#include "acquisition/frame.h"
#include "acquisition/image_file.h"
#include "acquisition/recording.h"

namespace celadon {
namespace {

using testing::AllOf;
using testing::HasSubstr;
namespace fs = std::filesystem;

/// A folder of its own for each test.
class Recording : public testing::Test {
 protected:
  Recording()
      : folder_(fs::path(testing::TempDir()) /
                (std::string("recording_") + testing::UnitTest::GetInstance()->current_test_info()->name())) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~Recording() override { fs::remove_all(folder_); }

  void write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
  }
  void write_index(const std::string& frames, const std::string& settings = "camera,Test\n") const {
    write("index.csv",
          "celadon-recording,1.0\n" + settings + "file,table_angle_deg,stamp_ns,exposure_ns,laser\n" + frames);
  }
  std::string url() const { return "replay:" + folder_.string(); }
  std::string refusal() const {
    const auto source = open_frame_source(url());
    EXPECT_FALSE(source);
    return source ? "" : source.error().message;
  }

  fs::path folder_;
};

/// Lends its bytes; counts what comes back.
class Lender : public FrameReturn {
 public:
  void give_back(std::uint32_t) noexcept override { ++returned; }
  int returned = 0;
};

/// Writes 8 bit colour by libpng's own simplified interface.
void write_png(const fs::path& file, std::uint32_t format, int width, int height,
               const std::vector<std::uint8_t>& bytes) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(width);
  image.height = static_cast<png_uint_32>(height);
  image.format = format;
  ASSERT_NE(png_image_write_to_file(&image, file.c_str(), 0, bytes.data(), 0, nullptr), 0) << image.message;
}

TEST_F(Recording, plays_back_bit_for_bit_what_was_recorded) {
  std::mt19937 random(1);
  for (const PixelFormat format : {PixelFormat::grey8, PixelFormat::yuyv}) {
    CameraMode mode{.width_px = 66,
                    .height_px = 20,
                    .stride_bytes = 160,
                    .format = format,
                    .identity = "Camera, 7 \"x\"",
                    .simulated = true};
    mode.shutter = Shutter::rolling;
    const std::size_t row_bytes = 66 * bytes_per_pixel(format);
    std::vector<std::vector<std::uint8_t>> sent;
    Lender lender;
    RecordingWriter writer(folder_, mode, {.date = "2026-02-03T04:05:06Z", .mode = "sweep", .profiles = 5});
    for (int i = 0; i < 5; ++i) {
      std::vector<std::uint8_t> bytes(160 * 20);
      for (auto& b : bytes) b = static_cast<std::uint8_t>(random());
      FrameInfo info;
      info.stamp_ns = 1'000'000 * i * i + 12345;
      info.exposure_ns = 7000 + i;
      const Frame frame(&lender, 0, bytes, info);
      const AngleAtInstant angle{0.1 * i, 1e-5 / 3 * i, 0.7 / 3};
      ASSERT_TRUE(writer.append(frame, angle,
                                i % 2 != 0 ? FrameUse::background
                                : i == 4   ? FrameUse::overlap
                                           : FrameUse::turn));
      sent.push_back(bytes);
    }
    ASSERT_TRUE(writer.finish());
    EXPECT_FALSE(fs::exists(folder_ / "index.csv.part"));

    auto source = open_frame_source(url());
    ASSERT_TRUE(source) << source.error().message;
    EXPECT_EQ((*source)->mode().width_px, 66);
    EXPECT_EQ((*source)->mode().height_px, 20);
    EXPECT_EQ((*source)->mode().stride_bytes, row_bytes);
    EXPECT_EQ((*source)->mode().format, format);
    EXPECT_EQ((*source)->mode().shutter, Shutter::rolling);
    EXPECT_EQ((*source)->mode().identity, mode.identity);
    EXPECT_TRUE((*source)->mode().simulated);
    EXPECT_EQ((*source)->mode().frame_period_ns, 4'000'000);
    ASSERT_NE((*source)->recorded(), nullptr);
    EXPECT_EQ((*source)->recorded()->date, "2026-02-03T04:05:06Z");
    EXPECT_EQ((*source)->recorded()->mode, "sweep");
    EXPECT_EQ((*source)->recorded()->profiles, 5);
    EXPECT_EQ((*source)->next(0).error().kind, CameraError::Kind::unsupported);
    for (int pass = 0; pass < 2; ++pass) {
      ASSERT_TRUE((*source)->start());
      std::vector<Frame> held;  // all at once: each has its own memory
      for (std::size_t i = 0; i < 5; ++i) {
        EXPECT_EQ((*source)->set_exposure(1).value(), 7000 + static_cast<int>(i));
        auto frame = (*source)->next(0);
        ASSERT_TRUE(frame) << frame.error().message;
        EXPECT_EQ(frame->info.sequence, i);
        EXPECT_EQ(frame->info.stamp_ns, static_cast<std::int64_t>(1'000'000 * i * i + 12345));
        EXPECT_EQ(frame->info.exposure_ns, static_cast<std::int64_t>(7000 + i));
        EXPECT_TRUE(frame->info.has_table_angle);
        EXPECT_EQ(frame->info.table_angle_rad, 0.1 * static_cast<int>(i));
        EXPECT_EQ(frame->info.table_angle_sigma_rad, 1e-5 / 3 * static_cast<int>(i));
        EXPECT_EQ(frame->info.table_speed_rad_per_s, 0.7 / 3);
        EXPECT_EQ(frame->info.laser_on, i % 2 == 0);
        EXPECT_EQ(frame->info.use, i % 2 != 0 ? FrameUse::background : i == 4 ? FrameUse::overlap : FrameUse::turn);
        held.push_back(std::move(*frame));
      }
      for (std::size_t i = 0; i < 5; ++i) {
        ASSERT_EQ(held[i].bytes().size(), row_bytes * 20);
        for (std::size_t row = 0; row < 20; ++row) {
          EXPECT_TRUE(std::equal(held[i].bytes().begin() + static_cast<std::ptrdiff_t>(row * row_bytes),
                                 held[i].bytes().begin() + static_cast<std::ptrdiff_t>((row + 1) * row_bytes),
                                 sent[i].begin() + static_cast<std::ptrdiff_t>(row * 160)));
        }
      }
      const auto end = (*source)->next(0);
      ASSERT_FALSE(end);
      EXPECT_EQ(end.error().kind, CameraError::Kind::end_of_stream);
    }
  }
}

TEST_F(Recording, colour_frames_become_grey_by_the_channel_named) {
  const std::vector<std::uint8_t> rgb{200, 10, 30, 0, 255, 0};
  write_png(folder_ / "a.png", PNG_FORMAT_RGB, 2, 1, rgb);
  const auto first_bytes = [&](const std::string& settings) {
    write_index("a.png,0,0,0,1\r\n", "camera,Test\n" + settings);
    auto source = open_frame_source(url());
    EXPECT_TRUE(source) << source.error().message;
    EXPECT_TRUE((*source)->start());
    auto frame = (*source)->next(0);
    EXPECT_TRUE(frame);
    return std::vector<int>(frame->bytes().begin(), frame->bytes().end());
  };
  EXPECT_EQ(first_bytes(""), (std::vector<int>{200, 0}));
  EXPECT_EQ(first_bytes("colour,green\n"), (std::vector<int>{10, 255}));
  EXPECT_EQ(first_bytes("colour,luma\n"),
            (std::vector<int>{(77 * 200 + 150 * 10 + 29 * 30 + 128) / 256, (150 * 255 + 128) / 256}));
  // Alpha is passed over, not blended.
  write_png(folder_ / "a.png", PNG_FORMAT_RGBA, 1, 1, {90, 80, 70, 0});
  EXPECT_EQ(first_bytes(""), (std::vector<int>{90}));
  write_png(folder_ / "a.png", PNG_FORMAT_GRAY, 3, 1, {1, 128, 255});
  EXPECT_EQ(first_bytes(""), (std::vector<int>{1, 128, 255}));
}

TEST_F(Recording, a_broken_index_is_refused_with_its_line) {
  write("a.pgm", "P5\n2 1\n255\nab");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("index.csv"), HasSubstr("errno 2")));
  write("index.csv", "celadon-recording,2.0\n");
  EXPECT_THAT(refusal(), HasSubstr("update Celadon"));
  write("index.csv", "file,angle\n");
  EXPECT_THAT(refusal(), HasSubstr("line 1"));
  write_index("");
  EXPECT_THAT(refusal(), HasSubstr("no frame"));
  write_index("a.pgm,0,0,0,1\n", "");
  EXPECT_THAT(refusal(), HasSubstr("camera is missing"));
  write_index("a.pgm,0,0,0,1\n", "camera,T\nfps,3\n");
  EXPECT_THAT(refusal(), AllOf(HasSubstr("line 3"), HasSubstr("fps,3")));
  for (const char* bad :
       {"a.pgm,nan,1,0,1", "a.pgm,1,1.5,0,1", "a.pgm,1,1,-1,1", "a.pgm,1,1,0,2", "a.pgm,1,1,0", "../a.pgm,1,1,0,1",
        "/etc/a.pgm,1,1,0,1", "a.bmp,1,1,0,1", "a.pgm,1,0,0,1", "a.yuyv,1,1,0,1", "a.pgm,1,99999999999999999999,0,1"}) {
    write_index("# first\na.pgm,0,0,0,1\n\n" + std::string(bad) + "\n");
    EXPECT_THAT(refusal(), HasSubstr("index.csv, line 7")) << bad;
  }
  write_index("a.pgm,0,0,0,1,new\n", "camera,T\n");
  EXPECT_THAT(refusal(), HasSubstr("6 fields"));
  write("index.csv",
        "celadon-recording,1.5\ncamera,T\nfps,3\nfile,table_angle_deg,stamp_ns,exposure_ns,laser\na.pgm,0,0,0,1,turn,0,"
        "0,0,1,0,0,new\n");
  EXPECT_TRUE(open_frame_source(url()));
}

TEST_F(Recording, frames_belong_to_the_turns_of_lasers) {
  write("a.pgm", "P5\n2 1\n255\nab");
  const auto with = [&](const std::string& lines) {
    write("index.csv", "celadon-recording,1.2\ncamera,T\nfile,table_angle_deg,stamp_ns,exposure_ns,laser\n" + lines);
  };
  with(
      "a.pgm,0,1,0,1,look,0,0,0,0\na.pgm,0,2,0,1,turn,0,0,0,2\na.pgm,0,3,0,0,background,0,0,0,0\n"
      "a.pgm,0,4,0,1,turn,0,0,0,0\na.pgm,0,5,0,1,turn,0,0,0,0\n");
  auto source = open_frame_source(url());
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ((*source)->recorded()->lasers, (std::vector<int>{2, 0}));
  ASSERT_TRUE((*source)->start());
  for (const int laser : {0, 2, 0, 0, 0}) EXPECT_EQ((*source)->next(0)->info.laser, laser);

  // Frames of 1.0 and 1.1 do not say.
  with("a.pgm,0,1,0,1\na.pgm,0,2,0,1,turn,0,0,0\n");
  source = open_frame_source(url());
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_TRUE((*source)->recorded()->lasers.empty());

  for (const char* bad : {"-1", "256", "left", "0,0", ""}) {
    with(std::string("a.pgm,0,1,0,1,turn,0,0,0,") + bad + "\n");
    EXPECT_THAT(refusal(), HasSubstr("index.csv, line 4")) << bad;
  }
}

TEST_F(Recording, frames_belong_to_stops_of_head_and_lift) {
  write("a.pgm", "P5\n2 1\n255\nab");
  const auto with = [&](const std::string& lines) {
    write("index.csv", "celadon-recording,1.3\ncamera,T\nfile,table_angle_deg,stamp_ns,exposure_ns,laser\n" + lines);
  };
  with(
      "a.pgm,0,1,0,1,look,0,0,0,0,0.25,0\na.pgm,0,2,0,1,turn,0,0,0,0,0.25,0\n"
      "a.pgm,0,3,0,0,background,0,0,0,0,-0.5,30\na.pgm,0,4,0,1,turn,0,0,0,0,-0.5,30\n");
  auto source = open_frame_source(url());
  ASSERT_TRUE(source) << source.error().message;
  const AxisStop first{0.25, 0}, second{-0.5, 30};
  EXPECT_EQ((*source)->recorded()->stops, (std::vector{first, second}));
  ASSERT_TRUE((*source)->start());
  for (const AxisStop& stop : {first, first, second, second}) EXPECT_EQ((*source)->next(0)->info.stop, stop);

  // Frames from before there were stops stand at 0.
  with("a.pgm,0,1,0,1\na.pgm,0,2,0,1,turn,0,0,0,1\n");
  source = open_frame_source(url());
  ASSERT_TRUE(source) << source.error().message;
  EXPECT_EQ((*source)->recorded()->stops, std::vector{AxisStop()});

  for (const char* bad : {"0.1", "0.1,high", ",0", "inf,0", "0,nan", "0,0,0"}) {
    with(std::string("a.pgm,0,1,0,1,turn,0,0,0,0,") + bad + "\n");
    EXPECT_THAT(refusal(), HasSubstr("index.csv, line 4")) << bad;
  }
}

TEST_F(Recording, what_a_frame_was_for_is_checked) {
  write("a.pgm", "P5\n2 1\n255\nab");
  const auto with = [&](const std::string& line) {
    write("index.csv",
          "celadon-recording,1.1\ncamera,T\nfile,table_angle_deg,stamp_ns,exposure_ns,laser\n" + line + "\n");
  };
  for (const char* bad : {"a.pgm,0,0,0,1,new,0,0,0", "a.pgm,0,0,0,0,turn,0,0,0", "a.pgm,0,0,0,1,background,0,0,0",
                          "a.pgm,180,0,0,1,turn,3.2,0,0", "a.pgm,0,0,0,1,turn,0,-1,0", "a.pgm,0,0,0,1,turn,0,0,nan",
                          "a.pgm,0,0,0,1,turn,0,0", "a.pgm,0,0,0,1,turn,0,0,0,0"}) {
    with(bad);
    EXPECT_THAT(refusal(), HasSubstr("index.csv, line 4")) << bad;
  }
  with("a.pgm,180,0,0,1,overlap,3.141592653589793,1e-5,0.5");
  EXPECT_TRUE(open_frame_source(url()));
}

TEST_F(Recording, a_frame_that_is_missing_or_of_another_size_is_named_when_it_comes) {
  write("a.pgm", "P5\n2 1\n255\nab");
  write("b.pgm", "P5\n3 1\n255\nabc");
  write_index("a.pgm,0,0,0,1\nb.pgm,1,1,0,1\nc.pgm,2,2,0,1\n");
  auto source = open_frame_source(url());
  ASSERT_TRUE(source);
  ASSERT_TRUE((*source)->start());
  ASSERT_TRUE((*source)->next(0));
  const auto other = (*source)->next(0);
  ASSERT_FALSE(other);
  EXPECT_THAT(other.error().message,
              AllOf(HasSubstr("b.pgm"), HasSubstr("3 x 1"), HasSubstr("2 x 1"), HasSubstr("line 5")));
}

TEST_F(Recording, images_that_lie_or_end_early_are_refused) {
  GreyImage image;
  const auto message = [&](const std::string& text) {
    write("x", text);
    const auto read = read_image(folder_ / "x", ColourChannel::red, image);
    EXPECT_FALSE(read) << text;
    return read ? "" : read.error().message;
  };
  EXPECT_THAT(message(""), HasSubstr("is empty"));
  EXPECT_THAT(message("GIF89a"), HasSubstr("neither"));
  EXPECT_THAT(message("P5\n"), HasSubstr("header"));
  EXPECT_THAT(message("P5\n2 2\n65535\nabcdefgh"), HasSubstr("65535"));
  EXPECT_THAT(message("P5\n65535 65535\n255\nabc"), HasSubstr("promises"));
  EXPECT_THAT(message("P5\n99999999999 1\n255\nabc"), HasSubstr("header"));
  EXPECT_THAT(message("P5\n-3 1\n255\nabc"), HasSubstr("header"));
  write_png(folder_ / "good.png", PNG_FORMAT_GRAY, 40, 30, std::vector<std::uint8_t>(1200, 9));
  std::ifstream stream(folder_ / "good.png", std::ios::binary);
  const std::string good((std::istreambuf_iterator<char>(stream)), {});
  for (std::size_t size = 8; size + 12 < good.size(); ++size) message(good.substr(0, size));
  // A header that promises 65535 x 3900 pixels in a file of some hundred bytes (its checksum corrected by libpng's own
  // writer: the image is real, then cut).
  std::mt19937 random(2);
  for (int trial = 0; trial < 400; ++trial) {
    std::string damaged = good;
    damaged[8 + random() % (good.size() - 8)] = static_cast<char>(random());
    write("x", damaged);
    static_cast<void>(read_image(folder_ / "x", ColourChannel::red, image));  // must return
  }
  EXPECT_THAT(read_image(folder_, ColourChannel::red, image).error().message, HasSubstr("regular file"));
}

RC_GTEST_PROP(RecordingIndex, formatting_and_parsing_agree, ()) {
  RecordingIndex index;
  index.camera = *rc::gen::nonEmpty(rc::gen::container<std::string>(rc::gen::inRange<char>(32, 127)));
  index.simulated = *rc::gen::arbitrary<bool>();
  index.shutter = *rc::gen::element(Shutter::global, Shutter::rolling);
  index.colour = *rc::gen::element(ColourChannel::red, ColourChannel::green, ColourChannel::luma);
  index.scan.mode = *rc::gen::element<std::string>("", "step", "sweep");
  index.scan.date = *rc::gen::element<std::string>("", "2026-02-03T04:05:06Z");
  index.scan.profiles = *rc::gen::inRange(0, 100000);
  index.saturated_level = *rc::gen::inRange(0, 256);
  std::int64_t stamp = *rc::gen::inRange<std::int64_t>(-1000, 1000);
  for (int i = 0; i < *rc::gen::inRange(1, 20); ++i) {
    index.frames.push_back(
        {.file = std::to_string(i).append(".pgm"),
         .table_angle_rad = *rc::gen::inRange(-1000000, 1000000) * 1e-3,
         .table_angle_sigma_rad = *rc::gen::inRange(0, 1000) / 3e7,
         .table_speed_rad_per_s = *rc::gen::inRange(-1000, 1000) / 3e2,
         .stamp_ns = stamp,
         .exposure_ns = *rc::gen::inRange<std::int64_t>(0, INT64_MAX),
         .use = *rc::gen::element(FrameUse::background, FrameUse::look, FrameUse::turn, FrameUse::overlap),
         .laser = *rc::gen::inRange(0, 256),
         .stop = {*rc::gen::inRange(-1000, 1000) / 7e2, *rc::gen::inRange(-1000, 1000) / 3.0}});
    stamp += *rc::gen::inRange<std::int64_t>(1, 1'000'000'000'000);
  }
  if (*rc::gen::arbitrary<bool>()) {
    index.yuv = ColourCoding{ColourLayout::yuyv, 0, *rc::gen::element(LumaWeights::bt601, LumaWeights::bt709),
                             *rc::gen::arbitrary<bool>()};
  }
  const std::string text = format_recording_index(index);
  RC_ASSERT(text.starts_with(index.yuv ? "celadon-recording,1.4\n" : "celadon-recording,1.3\n"));
  const auto parsed = parse_recording_index(text, "x");
  RC_ASSERT(parsed.has_value());
  RC_ASSERT(parsed->camera == index.camera);
  RC_ASSERT(parsed->simulated == index.simulated);
  RC_ASSERT(parsed->shutter == index.shutter);
  RC_ASSERT(parsed->colour == index.colour);
  RC_ASSERT(parsed->scan.mode == index.scan.mode);
  RC_ASSERT(parsed->scan.date == index.scan.date);
  RC_ASSERT(parsed->scan.profiles == index.scan.profiles);
  RC_ASSERT(parsed->saturated_level == index.saturated_level);
  RC_ASSERT(parsed->yuv == index.yuv);
  RC_ASSERT(parsed->frames.size() == index.frames.size());
  for (std::size_t i = 0; i < index.frames.size(); ++i) {
    const RecordedFrame &a = parsed->frames[i], &b = index.frames[i];
    RC_ASSERT(a.file == b.file);
    RC_ASSERT(a.stamp_ns == b.stamp_ns);
    RC_ASSERT(a.exposure_ns == b.exposure_ns);
    RC_ASSERT(a.use == b.use);
    RC_ASSERT(a.laser == b.laser);
    RC_ASSERT(a.stop == b.stop);
    RC_ASSERT(a.table_angle_rad == b.table_angle_rad);
    RC_ASSERT(a.table_angle_sigma_rad == b.table_angle_sigma_rad);
    RC_ASSERT(a.table_speed_rad_per_s == b.table_speed_rad_per_s);
  }
}

TEST_F(Recording, a_frame_that_outlives_its_source_ends_the_program) {
  write("a.pgm", "P5\n2 1\n255\nab");
  write_index("a.pgm,0,0,0,1\n");
  EXPECT_DEATH(
      {
        auto source = open_frame_source(url());
        static_cast<void>((*source)->start());
        auto frame = (*source)->next(0);
        source->reset();
      },
      "1 frames lent");
}

TEST(FrameSource, unknown_addresses_are_refused_with_the_known_ones) {
  for (const char* url : {"", "sim:", "http://x", "v4l2:", "/dev/video0"}) {
    const auto source = open_frame_source(url);
    ASSERT_FALSE(source) << url;
    EXPECT_EQ(source.error().kind, CameraError::Kind::unsupported);
    EXPECT_THAT(source.error().message, HasSubstr("replay:FOLDER"));
  }
}

TEST(FrameSource, devices_that_are_no_cameras_are_named) {
  const auto absent = open_frame_source("v4l2:/dev/no-such-video?width=640");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, CameraError::Kind::not_found);
  EXPECT_EQ(absent.error().errno_value, ENOENT);
  EXPECT_THAT(absent.error().message,
              AllOf(HasSubstr("/dev/no-such-video"), HasSubstr("errno 2"), HasSubstr("connect")));
  const auto null = open_frame_source("v4l2:/dev/null");
  ASSERT_FALSE(null);
  EXPECT_EQ(null.error().kind, CameraError::Kind::unsupported);
  EXPECT_THAT(null.error().message, HasSubstr("no video device"));
  for (const char* option :
       {"width=0", "width=70000", "height=x", "format=H264", "fps=x", "width", "=3", "width=1280x"}) {
    const auto refused = open_frame_source("v4l2:/dev/null?" + std::string(option));
    ASSERT_FALSE(refused);
    EXPECT_THAT(refused.error().message, AllOf(HasSubstr(option), HasSubstr("formats are GREY, Y10, ")));
  }
}

}  // namespace
}  // namespace celadon
